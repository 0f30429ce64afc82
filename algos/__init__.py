"""Learning and search: training of controllers, evaluation, runners."""

if __name__ != "warpvox.algos":
    # The folder is also importable as `algos` when the repository root is on sys.path: two copies of one
    # module.
    raise ImportError("import this package as warpvox.algos")
