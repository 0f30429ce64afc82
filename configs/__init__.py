"""Packaged YAML configuration; find files by `importlib.resources.files("warpvox.configs")`."""

if __name__ != "warpvox.configs":
    # The folder is also importable as `configs` when the repository root is on sys.path: two copies of one
    # module.
    raise ImportError("import this package as warpvox.configs")
