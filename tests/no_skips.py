"""Where nothing is optional, as in continuous integration, a test that is skipped fails: HHR_CI=1
says so.
"""

import os

import pytest


def fail_if_skipped(report):
    """Turn the report of a skipped test, or of a file that is skipped, into that of a failure."""
    expected = hasattr(report, "wasxfail")
    if not os.environ.get("HHR_CI") or not report.skipped or expected:
        return
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
    report.outcome = "failed"
    report.longrepr = (
        f"{reason}\nHHR_CI is set, and so no test may be skipped: install what is missing"
    )


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport():
    """Of a test; a file, whose import may skip all of it, has a report like that."""
    made = yield
    fail_if_skipped(made.get_result())


pytest_make_collect_report = pytest_runtest_makereport
