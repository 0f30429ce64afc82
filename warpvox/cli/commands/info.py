"""``warpvox info``: prints versions, devices and the kernel cache, for bug reports."""

import os
import platform
import sys
from collections.abc import Collection
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.console import Console
from rich.table import Table

import warpvox
from warpvox.io.console import echo, literal
from warpvox.system import processor_name, usable_cores


def run(config: object, given: Collection[str], console: Console) -> None:
    """Print a table of versions, devices and the kernel cache."""
    import torch
    import warp as wp

    from warpvox.devices.names import missing_cuda

    # Versions
    rows = [
        ("warpvox", f"{warpvox.__version__} in {Path(warpvox.__file__).parent}"),
        ("python", f"{platform.python_version()} in {sys.prefix}"),
        ("system", platform.platform()),
    ]
    for package in ("warp-lang", "torch", "rsl-rl-lib", "numpy", "gymnasium", "hydra-core", "usd-core"):
        try:
            rows.append((package, version(package)))
        except PackageNotFoundError:
            rows.append((package, "not installed"))

    # Devices
    vectors = torch.backends.cpu.get_cpu_capability()
    rows.append(("cpu", f"{processor_name()} ({vectors}), {usable_cores()} of {os.cpu_count()} cores usable"))
    missing = missing_cuda()
    if missing is not None:
        rows.append(("cuda", f"none: {missing}"))
    for index in range(torch.cuda.device_count() if missing is None else 0):
        properties = torch.cuda.get_device_properties(index)
        capability = properties.major, properties.minor
        about = f"{properties.name}, {properties.total_memory / 2**30:.0f} GiB, compute capability "
        about += ".".join(map(str, capability))
        # CUDA 13 compiles for nothing older.
        if capability < (7, 5):
            about += " (7.5 or newer is needed)"
        rows.append((f"cuda:{index}", about))

    # Kernel cache
    folder = Path(str(wp.config.kernel_cache_dir))
    files = [file for file in folder.rglob("*") if file.is_file()] if folder.is_dir() else []
    modules = sum(1 for item in folder.iterdir() if item.is_dir()) if folder.is_dir() else 0
    size = sum(file.stat().st_size for file in files) / 1e6
    rows.append(("kernel cache", f"{folder}: {modules} modules, {size:.1f} MB"))

    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in rows:
        table.add_row(literal(name), literal(value))
    console.print(table, highlight=False)
    echo(console, "`warpvox train preset=demo` trains a first robot, `warpvox tasks` lists the tasks.")
