"""``install()`` makes ``import evogym`` mean the drop-in, in processes of their own."""

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import pytest


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    return subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True)


def run_by(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "warpvox.evogym", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A folder with another package named evogym, as if it were installed."""
    (tmp_path / "evogym").mkdir()
    (tmp_path / "evogym" / "__init__.py").write_text("WHO = 'another'\n")
    return tmp_path


def test_a_script_runs_unchanged(tmp_path: Path) -> None:
    code = """
import warpvox.evogym; warpvox.evogym.install(); warpvox.evogym.install()
import gymnasium as gym
import evogym.envs
from evogym import EvoWorld, EvoSim, sample_robot
from evogym.utils import get_full_connectivity
from evogym.envs import *
import evogym.envs.base, evogym.simulator_cpp
import pickle, sys

assert evogym is warpvox.evogym and evogym.envs.base is sys.modules["warpvox.evogym.envs.base"]
assert evogym.EvoSim is warpvox.evogym.EvoSim and issubclass(evogym.envs.WalkingFlat, EvoGymBase)
assert evogym.utils.__spec__.name == evogym.utils.__name__ == "warpvox.evogym.utils"
assert pickle.loads(pickle.dumps(evogym.Pair(1, 2))) == evogym.Pair(1, 2)
body, connections = sample_robot((3, 3))
env = gym.make("Walker-v0", body=body, connections=connections)
env.reset()
env.step(env.action_space.sample())
try:
    import evogym.nonsense
except ModuleNotFoundError:
    print("done")
"""
    done = run(code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "done\n"


def test_an_installed_package_gives_way(package: Path) -> None:
    done = run("import warpvox.evogym as w; w.install(); import evogym; print(evogym is w)", package)
    assert done.stdout == "True\n", done.stderr


def test_one_that_is_imported_already_does_not(package: Path) -> None:
    done = run("import evogym, warpvox.evogym as w; w.install()", package)
    assert done.returncode != 0
    assert "InstallError: evogym has been imported already, from " in done.stderr
    assert "Call warpvox.evogym.install() before anything imports it." in done.stderr


def test_nothing_changes_without_it(package: Path) -> None:
    done = run("import warpvox.evogym.envs, evogym; print(evogym.WHO)", package)
    assert done.stdout == "another\n", done.stderr


def test_worlds_need_neither_torch_nor_warp(tmp_path: Path) -> None:
    code = """
import sys, numpy as np, warpvox.evogym as evogym
world = evogym.EvoWorld()
world.add_from_array("robot", evogym.sample_robot((4, 4))[0], 0, 0)
print(sorted({"torch", "warp", "gymnasium"} & set(sys.modules)))
"""
    done = run(code, tmp_path)
    assert done.stdout == "[]\n", done.stderr


@pytest.mark.parametrize("method", [name for name in multiprocessing.get_all_start_methods() if name != "fork"])
def test_processes_of_a_script_have_it_too(method: str, package: Path) -> None:
    (package / "run_it.py").write_text(
        "import multiprocessing, sys, evogym\n"
        "def begin(deep):\n"
        "    print(evogym.__name__, flush=True)\n"
        f"    process = multiprocessing.get_context('{method}').Process(target=begin, args=(deep + 1,))\n"
        "    if deep < 2: process.start(); process.join(); sys.exit(process.exitcode)\n"
        "if __name__ == '__main__': begin(0)\n"
    )
    command = [sys.executable, "-m", "warpvox.evogym", "run_it.py"]
    done = subprocess.run(command, cwd=package, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "warpvox.evogym\n" * 3), done.stderr


STARTS = {
    "a child of a child": "import os, sys; os.system(sys.executable + ' nested.py')",
    "joblib": "import joblib; joblib.Parallel(2)([joblib.delayed(exec)('import child')])",
}
"""Code that starts a process which imports or runs child.py, by what it uses."""


@pytest.mark.parametrize("start", STARTS)
def test_processes_that_others_start_have_it_too(start: str, package: Path, tmp_path: Path) -> None:
    if start == "joblib":
        pytest.importorskip("joblib")
    folder = tmp_path / "scripts"
    folder.mkdir()
    (folder / "child.py").write_text(
        "import evogym.envs.base, evogym\n"
        "from evogym.envs import *\n"
        "import sys\n"
        "assert evogym is sys.modules['warpvox.evogym'] and BenchmarkBase is evogym.envs.base.BenchmarkBase\n"
        "print(evogym.__name__, flush=True)\n"
    )
    (folder / "nested.py").write_text("import os, sys; os.system(sys.executable + ' child.py')")
    (folder / "run_it.py").write_text(
        f"if __name__ == '__main__':\n    import warpvox.evogym\n    warpvox.evogym.install()\n    {STARTS[start]}\n"
    )
    environment = os.environ | {"PYTHONPATH": str(package)}  # another evogym is installed
    done = subprocess.run([sys.executable, "run_it.py"], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.stdout == "warpvox.evogym\n", done.stderr


def test_paths_are_extended_once_and_in_front_of_what_is_installed(tmp_path: Path) -> None:
    code = """
import os, sys
os.environ["PYTHONPATH"] = "elsewhere"
before = list(sys.path)
import warpvox.evogym
assert (os.environ["PYTHONPATH"], sys.path) == ("elsewhere", before)
warpvox.evogym.install(); warpvox.evogym.install()
first, second = os.environ["PYTHONPATH"].split(os.pathsep)
assert second == "elsewhere" and os.listdir(first) == ["evogym"]
assert sys.path == [before[0], first, *before[1:]]
"""
    done = run(code, tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "code", ["import gym", "import gymnasium; gymnasium.make('Walking-v0')", "obs, reward, done, info = 1, 2, 3, 4, 5"]
)
def test_a_script_for_older_releases_is_told_what_changed(code: str, tmp_path: Path) -> None:
    (tmp_path / "old.py").write_text(code)
    done = run_by("old.py", folder=tmp_path)
    assert done.returncode == 1
    assert done.stderr.strip().endswith("step() five: obs, reward, terminated, truncated, info.")


def test_a_module_is_run_as_python_runs_it(package: Path) -> None:
    (package / "own.py").write_text("import sys, evogym; print(__name__, evogym.__name__, sys.argv[1:])")
    assert run_by("-m", "own", "-x", "a", folder=package).stdout == "__main__ warpvox.evogym ['-x', 'a']\n"
    assert "there is no module nowhere" in run_by("-m", "nowhere", folder=package).stderr


def test_a_script_is_run_as_python_runs_it(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("BODY = (3, 3)\n")
    (tmp_path / "run_it.py").write_text(
        "import pickle, sys, evogym, beside\n"
        "class Own: pass\n"
        "assert type(pickle.loads(pickle.dumps(Own()))) is Own and __name__ == '__main__'\n"
        "print(sys.argv[1:], evogym.sample_robot(beside.BODY)[0].shape, evogym.__name__, __file__ == sys.argv[0])\n"
        "sys.exit(3)\n"
    )
    command = [sys.executable, "-m", "warpvox.evogym"]
    done = subprocess.run([*command, str(tmp_path / "run_it.py"), "--steps", "4"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (3, "")
    assert done.stdout == "['--steps', '4'] (3, 3) warpvox.evogym True\n"
    lost = subprocess.run([*command, "nowhere.py"], capture_output=True, text=True)
    assert lost.returncode == 2
    assert "there is no script nowhere.py" in lost.stderr
