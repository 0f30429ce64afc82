"""The suites of ``warpvox bench``, one a file, and what they share.

A suite is a function ``(config, report)`` that checks results before it prints their times, shows its tables with
``report.table``, and adds to ``report.figures`` what they lack. It raises SimulationError if a result is wrong.
"""
