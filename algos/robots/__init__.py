"""Trained robots as small files: the zoo of the package, and the user's own.

A :class:`Robot` is a body with its policy and what is known of both. ``warpvox zoo`` lists those of the package.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
