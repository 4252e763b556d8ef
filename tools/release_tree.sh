#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Make the tree of a binary release from the last commit: bloom's pipeline takes no key that rosdep
# resolves to pip, and finds no package inside another. Commit it to the release branch, and tag it.
#
#   tools/release_tree.sh [FOLDER]    default build/release; with LIBRARIES=no not from PyPI
#
# ros2_ident           without tests and tools; bokeh, the page's, is not required
# ros2_ident_msgs      msg_defs/
# ros2_ident_vendor    what apt, or rosdep, does not have: rosbags, mcap, lz4 and zstandard
set -euo pipefail
cd "${0%/*}/.."
mkdir -p "${1:-build/release}"
out=$(realpath "${1:-build/release}")
[ -z "$(ls "$out")" ] || { echo "release_tree: $out is not empty; give another folder." >&2; exit 1; }
vendor=$out/ros2_ident_vendor
mkdir "$vendor"
version=$(git show HEAD:package.xml | sed -n 's:.*<version>\(.*\)</version>.*:\1:p')

git archive --prefix=ros2_ident/ HEAD CHANGELOG.rst LICENSE README.md package.xml setup.cfg setup.py \
  bags config launch resource ros2_ident | tar -x -C "$out"
git archive --prefix=ros2_ident_msgs/ HEAD:msg_defs | tar -x -C "$out"
git archive --prefix=ros2_ident_vendor/ HEAD LICENSE | tar -x -C "$out"

sed -i '/<!-- rosdep/,/-->/d; /bokeh/d; /mcap/d; /<test_depend>/d
  s/python3-rosbags-pip/ros2_ident_vendor/' "$out/ros2_ident/package.xml"
heading="$version ($(git log -1 --format=%cs))"
sed -i "/^Forthcoming$/{N; s/.*/$heading\n${heading//?/-}/}" "$out"/*/CHANGELOG.rst

# The newest of rosbags that needs no apsw. Its metadata tell its version to results.
if [ "${LIBRARIES:-}" != no ]; then
  scratch=$(mktemp -d)
  trap 'rm -rf "$scratch"' EXIT
  cat > "$scratch/pins" <<'PINS'
lz4==4.4.5 --hash=sha256:5f0b9e53c1e82e88c10d7c180069363980136b9d7a8306c4dca4f760d60c39f0
mcap==1.6.0 --hash=sha256:7cd37fba2cf51d033f2139ca837d2ed3024dcec3cd9f8ecdf3d4d15930df6e17
rosbags==0.11.0 --hash=sha256:2ce27d8dc37f554f10bf5962f665331ce16f43aba304c6c233eb15fab05b61ab
zstandard==0.25.0 --hash=sha256:7713e1179d162cf5c7906da876ec2ccb9c3a9dcbdffef0cc7f70c3667a205f0b
PINS
  "${PYTHON:-python3}" -m pip download --quiet --no-deps --require-hashes \
    --no-binary lz4,zstandard --dest "$scratch" -r "$scratch/pins"
  for wheel in "$scratch"/*.whl; do "${PYTHON:-python3}" -m zipfile -e "$wheel" "$vendor"; done
  rm "$vendor"/*.dist-info/RECORD
  for source in "$scratch"/*.tar.gz; do tar -x -C "$scratch" -f "$source"; done
  mkdir "$vendor/lz4"
  cp -r "$scratch"/lz4-*/lz4/{__init__.py,version.py,_version.c,frame} "$vendor/lz4"
  cp "$scratch"/lz4-*/LICENSE "$vendor/LICENSE.lz4"
  cp -r "$scratch"/zstandard-*/{zstandard,c-ext,zstd} "$vendor"
  cp "$scratch"/zstandard-*/LICENSE "$vendor/LICENSE.zstandard"
fi

mkdir "$vendor/resource"
touch "$vendor/resource/ros2_ident_vendor"
cp "$out/ros2_ident/setup.cfg" "$vendor"
cat > "$vendor/package.xml" <<XML
<?xml version="1.0"?>
<package format="3">
  <name>ros2_ident_vendor</name>
  <version>$version</version>
  <description>The Python libraries of ros2_ident that no rosdep key brings: rosbags, mcap, lz4, zstandard.</description>
  <maintainer email="maintainers@ros2-ident.invalid">ros2_ident developers</maintainer>
  <license file="LICENSE">Apache-2.0</license>
  <license>MIT</license>
  <license file="LICENSE.zstandard">BSD-3-Clause</license>
  <depend>liblz4-dev</depend>
  <build_depend>python3-dev</build_depend>
  <exec_depend>python3-numpy</exec_depend>
  <exec_depend>python3-ruamel.yaml</exec_depend>
  <exec_depend>python3-typing-extensions</exec_depend>
  <export>
    <build_type>ament_python</build_type>
  </export>
</package>
XML
cat > "$vendor/setup.py" <<'PY'
from glob import glob
import sys

from setuptools import Extension, find_namespace_packages, setup

NAME = 'ros2_ident_vendor'
LIBRARIES = ('lz4', 'mcap', 'rosbags', 'zstandard')
SITE = 'lib/python{}.{}/site-packages'.format(*sys.version_info)
# As zstandard's own build: its copy of zstd, whose symbols stay inside.
SINGLE = [('ZSTD_SINGLE_FILE', None), *((f'{x}LIB_VISIBLE', '') for x in ('ZSTD', 'ZDICT'))]
ZSTD = {
    'include_dirs': ['c-ext', 'zstd'],
    'define_macros': [*SINGLE, ('ZSTDERRORLIB_VISIBLE', '')],
    'extra_compile_args': ['-fvisibility=hidden'],
}

setup(
    name=NAME,
    version='@VERSION@',
    packages=find_namespace_packages(include=[p for x in LIBRARIES for p in (x, f'{x}.*')]),
    ext_modules=[
        Extension('lz4._version', ['lz4/_version.c'], libraries=['lz4']),
        Extension('lz4.frame._frame', ['lz4/frame/_frame.c'], libraries=['lz4']),
        Extension('zstandard.backend_c', ['c-ext/backend_c.c'], **ZSTD),
    ],
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml', *glob('LICENSE*')]),
        *((f'{SITE}/{x}', glob(f'{x}/METADATA')) for x in glob('*.dist-info')),
    ],
    zip_safe=False,
)
PY
sed -i "s/@VERSION@/$version/" "$vendor/setup.py"
echo "release_tree: $out"
