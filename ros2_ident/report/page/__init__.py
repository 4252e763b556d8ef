# SPDX-License-Identifier: Apache-2.0
"""The page on a result directory: `report.html`, one file that needs nothing else."""

from ros2_ident.errors import ErrorCode

try:
    from ros2_ident.report.page.assemble import write_report as write_report
    from ros2_ident.report.page.live import LivePage as LivePage
    from ros2_ident.report.page.several import write_comparison as write_comparison
except ModuleNotFoundError as missing:
    if (missing.name or '').split('.')[0] not in ('bokeh', 'jinja2', 'markupsafe'):
        raise
    raise ErrorCode.INVALID_GOAL.error(
        f'a page needs {missing.name}; `pip install "ros2-ident[page]"` brings it'
    ) from None
