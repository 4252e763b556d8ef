# SPDX-License-Identifier: Apache-2.0
"""A bent arm of four joints, one of which slides, and its machine file."""

from pathlib import Path
from typing import Any

import yaml

from ros2_ident.machine.machine import Machine
from ros2_ident.models import load_machine

JOINTS = ('base', 'slide', 'elbow', 'wrist')
URDF = """<robot name="bent">
  <link name="ground"><inertial><mass value="9"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="column"><inertial><origin xyz="0.05 -0.1 0.2" rpy="0.3 -0.2 0.5"/><mass value="7.5"/>
    <inertia ixx="0.2" ixy="0.01" ixz="-0.02" iyy="0.3" iyz="0.03" izz="0.25"/></inertial></link>
  <link name="carriage"><inertial><origin xyz="0 0.1 0.3"/><mass value="4"/>
    <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.03"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0.2 0 0.01" rpy="0 0.1 0"/><mass value="3"/>
    <inertia ixx="0.01" ixy="0.002" ixz="0" iyy="0.04" iyz="0" izz="0.05"/></inertial></link>
  <link name="hand"><inertial><origin xyz="0.02 0.03 0.1"/><mass value="1.5"/>
    <inertia ixx="0.004" ixy="0" ixz="0" iyy="0.005" iyz="0.001" izz="0.003"/></inertial></link>
  <link name="tool"><inertial><origin xyz="0 0 0.05"/><mass value="0.4"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.0005"/></inertial></link>
  <joint name="foot" type="fixed"><parent link="world"/><child link="ground"/></joint>
  <link name="world"/>
  <joint name="base" type="continuous"><parent link="ground"/><child link="column"/>
    <origin xyz="0 0.1 0.4" rpy="0.1 0 0.2"/><axis xyz="0 0 1"/></joint>
  <joint name="slide" type="prismatic"><parent link="column"/><child link="carriage"/>
    <origin xyz="0.3 0 0.1" rpy="0 0.7 0"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="revolute"><parent link="carriage"/><child link="upper"/>
    <origin xyz="0 0.2 0.5" rpy="1.5 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="wrist" type="revolute"><parent link="upper"/><child link="hand"/>
    <origin xyz="0.5 0 0" rpy="0 -0.4 0.3"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="flange" type="fixed"><parent link="hand"/><child link="tool"/>
    <origin xyz="0 0.05 0.15" rpy="0.2 0 0.4"/></joint>
</robot>
"""
TILT = {'free_fall': 9.7, 'base_roll': 0.4, 'base_pitch': -0.7}
LINKS = {
    'link_mass': [-5.0, 5.0, 'kg'],
    'link_moment': [-5.0, 5.0, 'kg m'],
    'link_inertia': [-5.0, 5.0, 'kg m^2'],
}
FLOW = {'default_flow_style': None, 'width': 1000}  # a section a line


def described(
    folder: Path,
    urdf: str = URDF,
    noise: float | None = None,
    drive: dict[str, object] | None = None,
    controller: dict[str, float] | None = None,
    **parameters: list[Any],
) -> Machine:
    """Write and load the machine file of the arm beside its description."""
    folder.mkdir(exist_ok=True)
    (folder / 'arm.urdf').write_text(urdf)
    content = {
        'machine': 'serial',
        'drives': list(JOINTS),
        'geometry': {'description': 'arm.urdf', **TILT},
        'effort_noise': noise,
        'drive': drive,
        'controller': {'cycle': 0.004, **(controller or {})},
        'parameters': parameters or LINKS,
    }
    stated = {key: value for key, value in content.items() if value is not None}
    (folder / 'arm.yaml').write_text(yaml.safe_dump(stated, sort_keys=False, **FLOW))
    return load_machine(folder / 'arm.yaml')
