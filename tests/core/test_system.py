"""What depends on the operating system; other systems than Linux are imitated."""

import ast
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tiny import tiny

from warpvox import system

LINUX_ONLY = {"fcntl", "resource", "termios", "tty", "pty", "pwd", "grp", "msvcrt", "winreg"}
OF_SYSTEMS = {
    "sys": {"platform", "getwindowsversion"},
    "os": {"name", "fork", "uname", "sysconf", "getuid", "geteuid", "killpg", "setsid", "sched_getaffinity", "fsync"},
    "platform": {"system"},
    "signal": {"SIGHUP", "SIGKILL", "SIGUSR1", "SIGBREAK"},
}


@pytest.mark.parametrize("platform", ["win32", "darwin"])
@pytest.mark.slow
def test_commands_run_without_what_only_linux_has(platform: str, tmp_path: Path) -> None:
    line = [sys.executable, str(Path(__file__).with_name("elsewhere.py")), platform, *tiny("train")]
    done = subprocess.run(line, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]


def test_single_quotes_that_cmd_leaves_are_taken_off(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    assert system.unquoted("'a=b'") == ("a=b" if system.WINDOWS else "'a=b'")
    monkeypatch.setattr(system, "WINDOWS", True)
    assert "Walker-v0" in warpvox("zoo", "'task=Walker-v0'").out
    assert [*map(system.unquoted, ("a='b'", "'", "''", ""))] == ["a='b'", "'", "", ""]


def test_only_one_module_asks_for_the_system(repository: Path) -> None:
    found = []
    for folder in ("warpvox", "kernels", "envs", "algos", "configs"):
        for path in (repository / folder).rglob("*.py"):
            if path.name != "system.py":
                found += [f"{path.relative_to(repository)}:{line}" for line in lines_about_systems(path)]
    assert not found


def lines_about_systems(path: Path) -> list[int]:
    """Where a module imports what not every system has, or asks which one it is."""
    lines = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {alias.name for alias in node.names} | {getattr(node, "module", None)}
            if names & LINUX_ONLY:
                lines.append(node.lineno)
        asks = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
        if asks and node.attr in OF_SYSTEMS.get(node.value.id, ()):
            lines.append(node.lineno)
    return lines


def write(root: Path, **files: str) -> None:
    for name, text in files.items():
        path = root / name.replace("__", "/").replace("_DOT_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_memory_of_linux_is_what_the_kernel_says(tmp_path: Path) -> None:
    write(tmp_path, proc__meminfo="MemTotal:  32000 kB\nMemFree:  100 kB\nMemAvailable:    2048 kB\n")
    assert system._linux_memory(tmp_path) == 2 << 20


def test_the_least_of_nested_control_groups_counts(tmp_path: Path) -> None:
    place = "sys__fs__cgroup__"
    files = {"proc__self__cgroup": "0::/jobs/one\n"}
    for name, limit, used, cache in (("jobs", "1000", 900, 50), ("jobs__one", "5000", 100, 0)):
        files[f"{place}{name}__memory_DOT_max"] = f"{limit}\n"
        files[f"{place}{name}__memory_DOT_current"] = f"{used}\n"
        files[f"{place}{name}__memory_DOT_stat"] = f"anon 7\ninactive_file {cache}\n"
    write(tmp_path, **files)
    assert system._memory_left_in_groups(tmp_path) == 150
    (tmp_path / "sys/fs/cgroup/jobs/memory.max").write_text("max\n")
    assert system._memory_left_in_groups(tmp_path) == 4900


def test_control_groups_limit_cores(tmp_path: Path) -> None:
    assert list(system._quotas(tmp_path)) == []
    write(
        tmp_path,
        proc__self__cgroup="4:cpu,cpuacct:/x\n0::/jobs/one\n",
        sys__fs__cgroup__cpu__cpu_DOT_cfs_quota_us="800000\n",
        sys__fs__cgroup__cpu__cpu_DOT_cfs_period_us="100000\n",
        sys__fs__cgroup__cpu__x__cpu_DOT_cfs_quota_us="-1\n",
        sys__fs__cgroup__cpu__x__cpu_DOT_cfs_period_us="100000\n",
        sys__fs__cgroup__jobs__cpu_DOT_max="max 100000\n",
        sys__fs__cgroup__jobs__one__cpu_DOT_max="250000 100000\n",
    )
    assert sorted(system._quotas(tmp_path)) == [3, 8]


def test_usable_cores_are_those_of_the_quota(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "_quotas", list)
    assert system.usable_cores() >= 1
    monkeypatch.setattr(system, "_quotas", lambda: [1, 10**6])
    assert system.usable_cores() == 1


def test_control_groups_of_version_1_and_none(tmp_path: Path) -> None:
    assert system._memory_left_in_groups(tmp_path) is None
    place = "sys__fs__cgroup__memory__memory_DOT_"
    write(
        tmp_path,
        proc__self__cgroup="4:cpu,cpuacct:/x\n3:memory:/docker/abc\n0::/x\n",
        **{
            f"{place}limit_in_bytes": "4000",
            f"{place}usage_in_bytes": "1500",
            f"{place}stat": "cache 3\ntotal_inactive_file 500\n",
        },
    )
    assert system._memory_left_in_groups(tmp_path) == 3000
    write(tmp_path, **{f"{place}limit_in_bytes": str(2**63 - 4096)})
    assert system._memory_left_in_groups(tmp_path) is None


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of addresses are those of Linux")
def test_a_limit_of_addresses_counts(tmp_path: Path) -> None:
    code = (
        "import resource\nfrom warpvox.system import available_memory\nbefore = available_memory()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (1 << 28, 1 << 28))\nprint(before, available_memory())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, after = map(int, done.stdout.split())
    assert after < 1 << 28 < before
