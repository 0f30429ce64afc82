"""Stages of the physics, one per file; ``step.py`` lists them in order, ``kit.py`` has the tools to write them."""

if __name__ != "warpvox.kernels":
    # The folder is also importable as `kernels` when the repository root is on sys.path; that would register
    # every Warp module a second time under another name.
    raise ImportError("import this package as warpvox.kernels")
