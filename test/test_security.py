# SPDX-License-Identifier: Apache-2.0
"""What SECURITY.md says: who may do what, what the environment consists of, what files may do."""

from html.parser import HTMLParser
import importlib.util
import json
from pathlib import Path
import re
import xml.etree.ElementTree as ElementTree

import markupsafe
import numpy as np
import pytest
from report_cases import write_diagnosed, write_identified
from ros_helpers import Here, MACHINE, new_domain

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.description import judged_tree
from ros2_ident.report.page import write_report

ROOT = Path(__file__).parents[1]
QUERIES = ('publisher', 'subscriber', 'service')


def allowed(node: str) -> dict[tuple[str, str], set[str]]:
    """Return full names by kind and right, of the policy's profile of a node."""
    tree = ElementTree.parse(ROOT / 'config/sros2/policy.xml')
    (profile,) = tree.iterfind(f'.//profile[@node="{node}"]')
    out: dict[tuple[str, str], set[str]] = {}
    for group in profile:
        ((right, rule),) = group.attrib.items()
        assert rule == 'ALLOW'
        names = [str(x.text) for x in group]
        full = {f'/{node}{x[1:]}' if x[0] == '~' else f'/{x}' for x in names}
        assert len(full) == len(names) and (group.tag, right) not in out
        out[group.tag, right] = full
    return out


def without_actions(names: set[str]) -> set[str]:
    return {x for x in names if '/_action/' not in x}


@pytest.mark.ros
def test_the_policy_allows_what_the_node_does_and_nothing_else(tmp_path):
    station = Here(new_domain(), tmp_path, machine_file=str(MACHINE))
    try:
        ask = {x: getattr(station.node, f'get_{x}_names_and_types_by_node') for x in QUERIES}
        expected = {'/identifier/status', '/identifier/diagnose/_action/status'}
        station.until(
            lambda: expected <= {x for x, _ in ask['publisher']('identifier', '/')}, 'its topics'
        )
        used = {kind: {x for x, _ in ask[kind]('identifier', '/')} for kind in QUERIES}
    finally:
        station.close()
    assert allowed('identifier') == {
        ('topics', 'publish'): without_actions(used['publisher']),
        ('topics', 'subscribe'): used['subscriber'] | {'/clock'},
        ('services', 'reply'): without_actions(used['service']),
        ('actions', 'execute'): {
            x.split('/_action/')[0] for x in used['service'] if '/_action/' in x
        },
    }


def test_an_operator_may_ask_for_what_the_node_answers():
    node, operator = allowed('identifier'), allowed('operator')
    assert operator['actions', 'call'] == node['actions', 'execute']
    assert operator['topics', 'subscribe'] <= node['topics', 'publish']
    assert operator['services', 'request'] <= node['services', 'reply']


def test_the_inventory_names_every_locked_package():
    spec = importlib.util.spec_from_file_location('sbom', ROOT / 'tools/sbom.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found = module.inventory()
    assert (found['bomFormat'], found['specVersion']) == ('CycloneDX', '1.5')
    entries = {x['bom-ref']: x for x in found['components']}
    lock = (ROOT / 'requirements.lock').read_text(encoding='utf-8')
    pins = dict(re.findall(r'^([\w.-]+)==(\S+)', lock, re.MULTILINE))
    assert {x['name']: x['version'] for x in entries.values()} == pins
    numpy = entries[f'pkg:pypi/numpy@{pins["numpy"]}']
    assert 'BSD' in str(numpy['licenses'])
    edges = {x['ref']: x['dependsOn'] for x in found['dependencies']}
    assert numpy['bom-ref'] in edges[f'pkg:pypi/scipy@{pins["scipy"]}']
    own = found['metadata']['component']
    assert set(edges) == {own['bom-ref'], *entries}
    assert {y for x in edges.values() for y in x} <= set(entries)


def test_a_description_has_no_entities():
    """One that stands for others, which stand for more, is text without end."""
    with pytest.raises(IdentError, match='has a DOCTYPE') as caught:
        judged_tree('<?xml version="1.0"?><!DOCTYPE r [<!ENTITY e "x">]><r>&e;</r>')
    assert caught.value.code == ErrorCode.BAD_MACHINE_FILE


def test_an_element_has_no_more_attributes_than_any_that_is_known():
    """They were bounded by the size of the file alone."""
    names = [f"n{k} = '=='" for k in range(101)]
    comment = '<!-- ' + 300 * '=' + ' -->'
    judged_tree(f'<mujoco>{comment}<size {" ".join(names[:100])}/></mujoco>')
    with pytest.raises(IdentError, match='an element of more than 100 attributes') as caught:
        judged_tree(f'<mujoco><size {" ".join(names)}/></mujoco>')
    assert caught.value.code == ErrorCode.BAD_MACHINE_FILE


def test_a_body_has_no_more_joints_than_directions():
    """Of hundreds of joints in a row pinocchio makes a model of gigabytes."""
    joints = [f'<joint name="j{k}" axis="0 0 1"/>' for k in range(7)]
    text = '<mujoco><worldbody><body name="arm">{}</body></worldbody></mujoco>'
    judged_tree(text.format(''.join(joints[:6])))
    with pytest.raises(IdentError, match='a body arm of 7 joints and may have 6'):
        judged_tree(text.format(''.join(joints)))


class Tags(HTMLParser):
    """The tags of a page, with their attributes."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, sorted(name for name, _ in attrs)))


def renamed(value, old, new):
    """Return nested plain data with a word replaced in every text, keys too."""
    if isinstance(value, dict):
        return {renamed(k, old, new): renamed(v, old, new) for k, v in value.items()}
    if isinstance(value, list):
        return [renamed(x, old, new) for x in value]
    return value.replace(old, new) if isinstance(value, str) else value


def test_names_in_a_result_are_only_text_on_its_page(tmp_path):
    evil = '"><svg onload=x></script><img src=x onerror=alert(1)>$$'
    pages = {}
    for name in ('drivex', evil):
        folder = tmp_path / str(len(pages))
        write_identified(folder)
        write_diagnosed(folder)
        for path in folder.glob('*.json'):
            data = json.loads(path.read_text())
            for old in ('drive_1', 'emps_axis'):
                data = renamed(data, old, name)
            path.write_text(json.dumps(data))
        for path in folder.glob('*.npz'):
            with np.load(path) as file:
                arrays = {k: file[k] for k in file.files}
            for key, array in arrays.items():
                if array.dtype.kind == 'U':
                    for old in ('drive_1', 'emps_axis'):
                        array = np.array([x.replace(old, name) for x in array.ravel().tolist()])
                    arrays[key] = array.reshape(arrays[key].shape)
            np.savez(path, **arrays)
        pages[name] = write_report(folder).read_text(encoding='utf-8')
    assert evil not in pages[evil]
    assert Tags(pages[evil]).found == Tags(pages['drivex']).found
    assert markupsafe.escape(evil) in pages[evil]
    # a text with $$ would be MathML
    assert 'axis_label: new M.PlainText({text: made.label})' in pages[evil]
