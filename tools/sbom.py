# SPDX-License-Identifier: Apache-2.0
"""Write the packages that the locked environment consists of as a CycloneDX file.

Names and versions come from requirements.lock, licences and dependencies from what is installed.

Example: python tools/sbom.py build/sbom.cdx.json
"""

from collections.abc import Iterator
import importlib.metadata as metadata
import json
from pathlib import Path
import re
import sys
from typing import Any
import xml.etree.ElementTree as ElementTree

ROOT = Path(__file__).parents[1]
_PIN = re.compile(r'^([\w.-]+)==([\w.]+)', re.MULTILINE)


def reference(name: str, version: str) -> str:
    """Return the package URL of what PyPI has."""
    return f'pkg:pypi/{re.sub(r"[-_.]+", "-", name).lower()}@{version}'


def installed(name: str, version: str) -> metadata.Distribution | None:
    """Return the installed package, None where it is not there or has another version."""
    try:
        found = metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return None
    return found if found.version == version else None


def of_ros(name: str) -> list[str]:
    """Return the licences of a package of ROS, whose wheel brings its package.xml."""
    folder = re.sub(r'^ros-(jazzy-)?', '', name).replace('-', '_')
    path = Path(sys.prefix, 'share', folder, 'package.xml')
    if not name.startswith('ros-') or not path.is_file():
        return []
    return [str(x.text) for x in ElementTree.parse(path).getroot().findall('license')]


def licences(found: metadata.Distribution) -> list[dict[str, Any]]:
    """Return a package's licence, as an expression where it states one."""
    if expression := found.metadata.get('License-Expression'):
        return [{'expression': expression}]
    said = (found.metadata.get('License') or '').strip()
    classes = [
        x.rsplit(' :: ', 1)[1]
        for x in found.metadata.get_all('Classifier', ())
        if x.startswith('License :: ') and x.count(' :: ') > 1
    ]
    if said and '\n' not in said and len(said) < 80:
        classes = [said]
    return [{'license': {'name': name}} for name in classes or of_ros(found.name)]


def needed(found: metadata.Distribution, known: dict[str, str]) -> Iterator[str]:
    """Yield references of the locked packages that a package asks for without an extra."""
    for line in found.requires or ():
        name = re.match(r'[\w.-]+', line)
        if name and 'extra ==' not in line:
            key = re.sub(r'[-_.]+', '-', name[0]).lower()
            if key in known:
                yield reference(key, known[key])


def inventory() -> dict[str, Any]:
    """Return the content of the file."""
    text = (ROOT / 'requirements.lock').read_text(encoding='utf-8')
    pins = _PIN.findall(text)
    known = {re.sub(r'[-_.]+', '-', name).lower(): version for name, version in pins}
    package = ElementTree.parse(ROOT / 'package.xml').getroot()
    version = str(package.findtext('version'))
    own = reference('ros2_ident', version)
    components, edges = [], [{'ref': own, 'dependsOn': [reference(*pin) for pin in pins]}]
    for name, version_ in pins:
        purl = reference(name, version_)
        entry: dict[str, Any] = {
            'type': 'library',
            'bom-ref': purl,
            'name': name,
            'version': version_,
            'purl': purl,
        }
        found = installed(name, version_)
        if found and (stated := licences(found)):
            entry['licenses'] = stated
        components.append(entry)
        depends = sorted(set(needed(found, known))) if found else []
        edges.append({'ref': purl, 'dependsOn': depends})
    return {
        'bomFormat': 'CycloneDX',
        'specVersion': '1.5',
        'version': 1,
        'metadata': {
            'component': {
                'type': 'application',
                'bom-ref': own,
                'name': 'ros2_ident',
                'version': version,
                'purl': own,
                'licenses': [{'license': {'id': str(package.findtext('license'))}}],
            }
        },
        'components': components,
        'dependencies': edges,
    }


def main() -> None:
    """Write the file that is asked for, and say what is in it."""
    path = Path(sys.argv[1])
    found = inventory()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found, indent=1) + '\n', encoding='utf-8')
    unknown = sum('licenses' not in x for x in found['components'])
    print(f'{path}: {len(found["components"])} packages, {unknown} without a stated licence')


if __name__ == '__main__':
    main()
