# SPDX-License-Identifier: Apache-2.0
"""What URDF and MJCF files share: a tree of XML, its elements by name, numbers with all digits."""

from collections.abc import Iterable
import xml.etree.ElementTree as ET

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import mark


def parsed(text: str) -> ET.Element:
    """Return the root of a description that is judged, its comments kept."""
    return ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))


def written(root: ET.Element) -> str:
    """Return the text of a description."""
    ET.indent(root)
    text = ET.tostring(root, encoding='unicode')
    return f"<?xml version='1.0' encoding='utf-8'?>\n<!-- {mark('export')} -->\n{text}\n"


def number(value: float) -> str:
    """Return a number's text with all of its digits."""
    return repr(float(value))


def numbers(values: Iterable[float]) -> str:
    """Return the text of several numbers, blanks between."""
    return ' '.join(number(value) for value in values)


def named(elements: Iterable[ET.Element], tag: str, name: str, remedy: str) -> ET.Element:
    """Return the element of a name.

    Args:
        elements: Where it is looked for.
        tag: What they are.
        name: Its name.
        remedy: What to do where there is none.

    Raises:
        IdentError: BAD_MACHINE_FILE where there is none.
    """
    for element in elements:
        if element.get('name') == name:
            return element
    raise IdentError(
        ErrorCode.BAD_MACHINE_FILE, f'the description has no {tag} {name}; {remedy}'
    )


def put_inertial(body: ET.Element, new: ET.Element) -> None:
    """Put an inertial into a body, in the place of the one it has."""
    old = body.find('inertial')
    if old is not None:
        body.remove(old)
    body.insert(0, new)
