"""The suites of ``warpvox bench``, one a file, and what they share.

A suite is a function ``(config, report)`` that checks results before it prints their times, shows its tables with
``report.table``, and returns its figures for ``summary.json``. It raises SimulationError if a result is wrong.
"""
