# SPDX-License-Identifier: Apache-2.0
"""Identify drive parameters from recorded drive data and say where the simulation falls short."""


def package_version() -> str:
    """Return the version of this package, `unknown` where it runs from an uninstalled copy."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(__name__)
    except PackageNotFoundError:
        return 'unknown'
