"""The kernels compile for CUDA, on machines without a GPU too (Warp carries the compiler)."""

import pytest
import warp as wp

from warpvox.kernels import sensing
from warpvox.kernels.reset import reset_kernel
from warpvox.kernels.step import action_kernel, step_kernel

ARCHITECTURE = 90  # Hopper


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_every_kernel_of_a_step_becomes_ptx(precision, tmp_path):
    built = [step_kernel(precision, 1), action_kernel(precision), reset_kernel(precision)]
    for number, kernel in enumerate([*built, *sensing.kernels(precision).values()]):
        folder = tmp_path / str(number)
        wp.compile_aot_module(kernel.module, arch=ARCHITECTURE, module_dir=str(folder), use_ptx=True)
        text = next(folder.glob("*.ptx")).read_text()
        assert kernel.func.__name__ in text
