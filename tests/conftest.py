"""What this machine lacks for some tests is said at the end, once, with the command that installs it."""

from collections import Counter

NEEDS = "Skipped: needs "


def pytest_terminal_summary(terminalreporter):
    """Name every program that tests were skipped for; their reasons begin with `needs` and end with a command."""
    lacking = Counter(
        report.longrepr[2].removeprefix(NEEDS)
        for report in terminalreporter.stats.get("skipped", [])
        if isinstance(report.longrepr, tuple) and report.longrepr[2].startswith(NEEDS)
    )
    if lacking:
        terminalreporter.section("NOT TESTED ON THIS MACHINE", sep="!", red=True, bold=True)
        for what, count in sorted(lacking.items()):
            terminalreporter.write_line(f"{count} test{'s' * (count > 1)} not run: needs {what}", red=True, bold=True)
