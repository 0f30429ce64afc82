"""The kernels compile for CUDA, on machines without a GPU too (Warp carries the compiler)."""

import pytest
import torch
import warp as wp

from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import make_vec
from warpvox.kernels import episodes, ppo, sensing
from warpvox.kernels.group import choose, group_kernel
from warpvox.kernels.reset import reset_kernel, save, settle, shift_kernel
from warpvox.kernels.reverse import reverse_kernel
from warpvox.kernels.step import STAGES, action_kernel, stage_kernel, step_kernel

AMPERE, ADA, HOPPER, BLACKWELL, RTX_50 = 80, 89, 90, 100, 120


FAST, EXACT = ("fast", "float32"), ("exact", "float64")
CASES = pytest.mark.parametrize(("arithmetic", "precision"), [FAST, ("fast", "float64"), EXACT])


def kernels_of_steps(arithmetic, precision):
    """The control step, its actions and resets."""
    walker = choose(dict(point=36, mover=36, spring=104, rigid=8), precision, "cuda:0")
    return [
        step_kernel(arithmetic, precision, 1),
        *([group_kernel(walker)] if arithmetic == "fast" else []),
        action_kernel(precision),
        reset_kernel(precision),
    ]


LEARNING = [kernel for kernel in vars(ppo).values() if isinstance(kernel, wp.Kernel)]


def kernels_of_cuda(arithmetic, precision):
    """Every kernel that is launched on CUDA: those of steps, all sensing, episodes and learning."""
    return [*kernels_of_steps(arithmetic, precision), *kernels_besides(precision)]


def kernels_besides(precision):
    own = [episodes.finite_kernel(precision), shift_kernel(precision)]
    return [*sensing.KERNELS.values(), *episodes.KERNELS.values(), *own, *LEARNING]


def build(kernel, architecture, folder):
    wp.compile_aot_module(kernel.module, arch=architecture, module_dir=str(folder), use_ptx=True)
    return next(folder.glob("*.ptx")).read_text()


@pytest.mark.parametrize(
    ("arithmetic", "precision"),
    [FAST, pytest.param("fast", "float64", marks=pytest.mark.slow), pytest.param(*EXACT, marks=pytest.mark.slow)],
)
def test_every_kernel_of_a_step_becomes_ptx(arithmetic, precision, tmp_path):
    check(kernels_of_steps(arithmetic, precision), tmp_path)


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_the_reverse_pass_becomes_ptx(precision, tmp_path):
    check([reverse_kernel(precision, 1)], tmp_path)


def test_every_kernel_of_sensing_episodes_and_learning_becomes_ptx(tmp_path):
    check(kernels_besides("float32"), tmp_path)


def check(kernels, tmp_path):
    for number, kernel in enumerate(kernels):
        text = build(kernel, HOPPER, tmp_path / str(number))
        assert kernel.func.__name__ in text
        assert f".target sm_{HOPPER}" in text


@pytest.mark.slow
@pytest.mark.parametrize("architecture", [AMPERE, ADA, BLACKWELL, RTX_50])
@CASES
def test_other_generations_too(arithmetic, precision, architecture, tmp_path):
    for number, kernel in enumerate(kernels_of_cuda(arithmetic, precision)):
        assert f".target sm_{architecture}" in build(kernel, architecture, tmp_path / str(number))


@pytest.mark.slow
@CASES
def test_stages_alone_become_ptx(arithmetic, precision, tmp_path):
    """Per-stage times on a GPU launch the stages one by one."""
    for number, stage in enumerate([*STAGES[arithmetic], save, settle]):
        assert ".target sm_90" in build(stage_kernel(stage, precision, 1), HOPPER, tmp_path / str(number))


def test_no_other_kernel_is_launched(monkeypatch):
    """What the environments of all tasks launch in stepping and resetting is what the tests above compile."""
    launched = set()
    original = wp.launch

    def launch(kernel, *args, **options):
        launched.add(kernel)
        return original(kernel, *args, **options)

    monkeypatch.setattr(wp, "launch", launch)
    for task in task_ids():
        for rules in ("evogym", "paper"):
            env = make_vec(task, num_envs=1, device="cpu", dtype="float32", rules=rules, lanes=1, threads=1)
            env.reset()
            env.step(torch.ones((1, env.num_actions)))
    assert launched <= set(kernels_of_cuda("fast", "float32"))
    assert len(launched) > 5
