"""Exact arithmetic: the stages that repeat the released simulator's sums bit for bit, in float64.

``springs.py`` and ``substep.h`` hold springs, integration and strain limits, ``order.py`` the order of contacts. All
else is shared with the fast arithmetic.
"""
