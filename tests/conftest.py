"""What all tests share: hypothesis settings, the rule for tests that need a GPU, a command line, a browser."""

import gc
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import parallel
import pytest
from build_distributions import build, copy_sources
from hypothesis import HealthCheck, settings

parallel.one_thread_each()

# The same examples on every run, and no time limit for one: a shared machine may stall at any moment.
settings.register_profile("repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")

FIRST = (
    # While one process compiles kernels, the other one runs what needs none.
    *("test_config", "test_device", "test_protocol"),
    # Those that take longest, so that no process waits for another at the end.
    *("test_ray_executor", "test_faults", "test_recordings", "test_cuda_build", "test_pages"),
    *("test_population_evaluator", "test_evaluations", "test_codesign", "test_trust", "test_commands"),
)  # files that go first, in this order
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 30.0  # seconds for anything in the browser; a shared machine may stall
GRAVE = ("error", "warning")


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_auto_num_workers() -> int:
    """How many processes ``-n auto`` starts."""
    return parallel.workers()


@pytest.fixture(scope="session", autouse=True)
def kernels_are_compiled_once() -> Iterator[None]:
    """Processes that need a kernel at the same time wait for the one that compiles it."""
    with parallel.compiling_in_turn():
        yield


def pytest_collection_finish() -> None:
    """Leave libraries and tests out of garbage collection, which else takes 6 % of the time."""
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that go first; skip tests marked ``gpu`` where there is no CUDA device."""
    items.sort(key=lambda item: FIRST.index(item.path.stem) if item.path.stem in FIRST else len(FIRST))
    marked = [item for item in items if item.get_closest_marker("gpu")]
    if not marked:
        return
    import torch

    if not torch.cuda.is_available():
        for item in marked:
            item.add_marker(pytest.mark.skip(reason="no CUDA device"))


@pytest.fixture
def narrow_packs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Packs that different bodies share have the width that other tests have compiled; results hold for any."""
    monkeypatch.setattr("warpvox.algos.env_factory.most_lanes", lambda: 8)


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Tensors of tests are tiny: a pool of threads only costs time on a busy machine."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def interrupts_arrive() -> Iterator[None]:
    """Tests send SIGINT, to themselves and to their children; a shell script's background jobs ignore it."""
    before = signal.getsignal(signal.SIGINT)
    if before == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    if before == signal.SIG_IGN:
        signal.signal(signal.SIGINT, before)


class Outcome(NamedTuple):
    """What a command left: exit code and both streams."""

    code: int
    out: str
    err: str


@pytest.fixture
def warpvox(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture) -> Callable[..., Outcome]:
    """``warpvox("train", "seed=1")`` in an empty folder; it is to end with 0, or ``code`` (None: anyhow).

    With ``fails``, a phrase or several, it is to end with 2, and one line to say why: these phrases are in it.
    """
    import torch

    from warpvox.cli import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    threads = torch.get_num_threads()

    def call(*words: str, code: int | None = 0, fails: str | tuple[str, ...] | None = None) -> Outcome:
        capfd.readouterr()
        ended = main(words)
        torch.set_num_threads(threads)
        outcome = Outcome(ended, *capfd.readouterr())
        assert code is None or ended == (code if fails is None else 2), outcome
        if fails is not None:
            assert outcome.err.startswith("warpvox: "), outcome
            assert (outcome.err.count("\n"), "Traceback" in outcome.out + outcome.err) == (1, False), outcome
            phrases, said = (fails,) if isinstance(fails, str) else fails, " ".join(outcome.err.split())
            assert all(phrase in said or phrase in outcome.err for phrase in phrases), outcome
        return outcome

    return call


@pytest.fixture(scope="session")
def repository() -> Path:
    return Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def source_copy(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout to build distributions in, so that no build folder is left behind."""
    return copy_sources(repository, tmp_path_factory.mktemp("checkout"))


@pytest.fixture(scope="session")
def wheel(source_copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("wheel", source_copy, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def sdist(source_copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("sdist", source_copy, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def tab() -> Iterator[Any]:
    """A tab of headless Chromium, the one of the system, steered by Playwright."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None or os.name != "posix":
        pytest.skip(f"no browser is installed (looked for {', '.join(BROWSERS)})")
    # Of a module, not of the session: while it is open, nothing else in this process can run an event loop.
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
        page = browser.new_page()
        page.set_default_timeout(1000 * PATIENCE)
        page.problems = []
        page.on("pageerror", lambda error: page.problems.append(str(error)))
        page.on("console", lambda message: page.problems.append(message.text) if message.type in GRAVE else None)
        yield page
        browser.close()


@pytest.fixture
def open_page(tab: Any, wait_for: Callable) -> Callable[..., Any]:
    """``open_page(address, ready)``: the tab at an address, once the expression ``ready`` is true there.

    Its list ``problems`` holds what the console has complained about since.
    """

    def call(address: str, ready: str = "true", size: tuple[int, int] = (1000, 700)) -> Any:
        tab.goto("about:blank")
        tab.set_viewport_size({"width": size[0], "height": size[1]})
        tab.problems.clear()
        tab.goto(address)
        wait_for(tab, ready)
        return tab

    return call


@pytest.fixture(scope="session")
def wait_for() -> Callable[[Any, str], None]:
    """``wait_for(page, expression)``: until it is true. (Playwright's own way is barred by the pages' policies.)"""

    def call(page: Any, expression: str) -> None:
        end = time.monotonic() + PATIENCE
        while not page.evaluate(expression):
            assert time.monotonic() < end, f"never true: {expression}"
            time.sleep(0.02)

    return call
