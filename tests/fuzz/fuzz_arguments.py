"""Public functions, command lines and the editor under test: arguments of the wrong kind, size, shape or sense."""

from __future__ import annotations

import contextlib
import json
import random
import socket
import threading
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import fuzz_mutate as mutate
import numpy as np
from fuzz_files import design_arrays, fits_or_refused, world_trees
from fuzz_harness import Target

import warpvox
from warpvox.design import load_design, sample_design
from warpvox.errors import ConfigError
from warpvox.world import World, WorldObject

Draw = random.Random
COMMANDS = ("train", "codesign", "play")


class Stranger:
    """An object that fails whatever it is asked for."""

    def __array__(self, *_: object, **__: object) -> np.ndarray:
        raise KeyError("no array")

    def __len__(self) -> int:
        raise OSError("no length")


def argument(draw: Draw) -> Any:
    """Something that is hardly what a function expects, or just what it expects."""
    kind = draw.randrange(12)
    if kind == 0:
        return mutate.spoil_array(draw, draw.choice(design_arrays()))
    if kind == 1:
        return draw.choice(
            (np.int64(3), np.float32("nan"), np.bool_(True), np.str_("x"), 3 + 4j, b"x", Ellipsis, slice(3))
        )
    if kind == 2:
        return draw.choice((Stranger(), object, range(3), {1, 2}, (1,), (1, 2), iter([1, 2]), lambda: 1, Path("x")))
    if kind == 3:
        return mutate.spoil_tree(draw, draw.choice(design_arrays()).tolist())
    if kind == 4:
        return draw.choice(design_arrays())
    if kind == 5:
        return draw.choice((1, 2, 5))
    return mutate.value(draw)


# ---------------------------------------------------------------------------------------------- designs, worlds


def design_words(draw: Draw) -> object:
    """What load_design is given: names, sizes, texts, lists, arrays."""
    words = (
        "walker",
        "random",
        "random:5x7",
        "[[3,3],[4,4]]",
        "nowhere.json",
        "a\0b.npz",
        "x" * 5000 + ".npy",
        "/dev/zero",
    )
    if draw.random() < 0.5:
        return mutate.spoil_bytes(draw, draw.choice(words).encode(), b"random:3x").decode("utf-8", "replace")
    if draw.random() < 0.3:
        return draw.choice(("random:0x0", "random:99999x99999", "random:٣x٣", "random:" + "9" * 5000 + "x1", "~.json"))
    return argument(draw)


def use_design(given: object) -> None:
    """Load it, and put it into a task."""
    fits_or_refused(load_design(given))


def sampling(draw: Draw) -> tuple:
    """Shape, seed and weights."""
    weights = [draw.choice((0, 0.2, 0.2, 1, -1, float("nan"), "x")) for _ in range(draw.choice((4, 5, 5, 5, 6)))]
    shape = (draw.choice((1, 2, 5)), draw.choice((1, 3, 10**9))) if draw.random() < 0.7 else argument(draw)
    return shape, draw.choice((None, 0, 7, argument(draw))), draw.choice((None, weights, argument(draw)))


def world_calls(draw: Draw) -> list[tuple[str, list]]:
    """What is done to a world, call by call."""
    calls = []
    for _ in range(draw.randrange(1, 5)):
        name = draw.choice(("robot", "stone", "", "\ud800", 5, argument(draw)))
        place = [draw.choice((0, 1, 5, -1, 10**9, 1.5, True, argument(draw))) for _ in range(2)]
        cells = draw.choice((design_arrays()[0], [[1, 2]], argument(draw)))
        pairs = draw.choice((None, None, [[0], [1]], argument(draw)))
        calls.append(
            draw.choice(
                (
                    ("add_from_array", [name, cells, *place, pairs]),
                    ("move_object", [name, *place]),
                    ("remove_object", [name]),
                    ("add_from_json", [draw.choice((world_trees()[0], mutate.spoil_tree(draw, world_trees()[1])))]),
                    ("add_from_json", [argument(draw)]),
                )
            )
        )
    return [("", [draw.choice((1, 10, 10**4, 10**9, argument(draw))) for _ in range(2)]), *calls]


def use_world(calls: list[tuple[str, list]]) -> None:
    """A world that refuses a call stays as it was; at the end it can be written and read back."""
    world = World(*calls[0][1])
    for name, arguments in calls[1:]:
        before = world.key()
        try:
            getattr(world, name)(*arguments)
        except BaseException:
            assert world.key() == before
            raise
    assert all(isinstance(obj, WorldObject) for obj in world.objects.values())
    if world.objects:
        assert World.from_json(world.to_json()) == world


# ------------------------------------------------------------------------------------ simulation, environments


class Environments:
    """Simulations and environments that are made once and stepped with what they do not expect."""

    @cached_property
    def sim(self) -> Any:
        """Two environments of one small world."""
        from warpvox.simulation import Simulation

        return Simulation([World.from_json(world_trees()[0])] * 2, device="cpu", threads=1)

    @cached_property
    def vec(self) -> Any:
        """Two environments of a task."""
        return warpvox.make_vec("Walker-v0", "mini", 2, device="cpu", threads=1)

    @cached_property
    def gym(self) -> Any:
        """One environment as gymnasium has it."""
        from warpvox.envs.gym import VoxelEnv

        return VoxelEnv("Walker-v0", "mini", dtype="float32")

    def actions(self, draw: Draw) -> tuple[str, Any]:
        """Actions for one of the three."""
        import torch

        kind = draw.choice(("sim", "vec", "gym"))
        columns = getattr(self, kind).action_space.shape[0] if kind == "gym" else getattr(self, kind).num_actions
        shape = (columns,) if kind == "gym" else (2, columns)
        good = np.ones(shape)
        choice = draw.randrange(8)
        if choice == 0:
            return kind, good
        if choice == 1:
            good.flat[draw.randrange(good.size)] = draw.choice((np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-320))
            return kind, good
        if choice == 2:
            return kind, mutate.spoil_array(draw, good)
        if choice == 3:
            return kind, mutate.spoil_tree(draw, good.tolist())
        if choice == 4:
            kinds = (torch.float16, torch.int64, torch.bool, torch.complex64, torch.uint8, torch.bfloat16)
            return kind, torch.ones(shape, dtype=draw.choice(kinds))
        if choice == 5:
            changes = (
                lambda t: t.to_sparse(),
                lambda t: t.to("meta"),
                lambda t: t[..., :1],
                lambda t: t[None],
                lambda t: t.requires_grad_(),
                lambda t: t.expand(3, *shape),
            )
            return kind, draw.choice(changes)(torch.ones(shape))
        return kind, argument(draw)

    def use_actions(self, given: tuple[str, Any]) -> None:
        """A step leaves finite states, whatever was given."""
        import torch

        kind, actions = given
        env = getattr(self, kind)
        if kind == "gym":
            env.reset(seed=0)
        result = env.step(actions)
        sim = env if kind == "sim" else env.sim
        assert bool(torch.isfinite(sim.state()["pos"]).all())
        if kind == "gym":
            assert np.isfinite(result[0]).all()
            assert np.isfinite(result[1])

    MAKE = ("task", "designs", "num_envs", "device", "rules", "dtype", "seed", "lanes", "threads", "connections")
    MAKE += ("max_episode_steps", "obs", "physics")
    GOOD = {"task": "Walker-v0", "designs": "mini", "num_envs": 1, "device": "cpu", "threads": 1}  # noqa: RUF012

    def make_vec(self, draw: Draw) -> dict[str, Any]:
        """Arguments of make_vec with one or two that are wrong."""
        given = dict(self.GOOD)
        for _ in range(draw.choice((1, 1, 2))):
            given[draw.choice(self.MAKE)] = argument(draw)
        return given

    def use_make_vec(self, given: dict[str, Any]) -> None:
        """What is accepted makes a step."""
        if _large(given.get("num_envs")) or _large(given.get("threads")) or _large(given.get("lanes")):
            given = given | {"num_envs": 0}  # as many as fit the machine are a matter of memory, not of reading
        env = warpvox.make_vec(**given)
        env.reset()
        env.step(np.ones((env.num_envs, env.num_actions)))

    SIM = ("worlds", "device", "physics", "dtype", "lanes", "threads", "loose", "action_range")

    def simulation(self, draw: Draw) -> dict[str, Any]:
        """Arguments of Simulation with one or two that are wrong."""
        given: dict[str, Any] = {"worlds": [World.from_json(world_trees()[0])], "device": "cpu", "threads": 1}
        for _ in range(draw.choice((1, 1, 2))):
            given[draw.choice(self.SIM)] = argument(draw)
        return given

    def use_simulation(self, given: dict[str, Any]) -> None:
        """What is accepted makes a step."""
        from warpvox.simulation import Simulation

        if _large(given.get("threads")) or _large(given.get("lanes")):
            given = given | {"threads": 0}
        sim = Simulation(**given)
        sim.step(np.ones((sim.num_envs, sim.num_actions)))

    def targets(self) -> list[Target]:
        """One for every function."""
        return [
            Target("actions", self.actions, self.use_actions, weight=30),
            Target("make_vec", self.make_vec, self.use_make_vec, weight=3),
            Target("Simulation", self.simulation, self.use_simulation, weight=5),
        ]


def _large(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value > 64


# ------------------------------------------------------------------------------------------------ command line


def command_line(draw: Draw) -> tuple[str, list[str]]:
    """A command with words after it."""
    from warpvox.cli.help import flat_keys
    from warpvox.configs.schema import COMMANDS as SCHEMAS

    command = draw.choice(COMMANDS)
    keys = [name for name, _ in flat_keys(SCHEMAS[command])]
    return command, [_word(draw, keys) for _ in range(draw.choice((1, 1, 1, 2)))]


def _word(draw: Draw, keys: list[str]) -> str:
    key = draw.choice(keys)
    given = mutate.value(draw)
    values = (
        json.dumps(given) if not isinstance(given, list) else str(given)[:3000],
        str(given)[:3000],
        draw.choice(
            ("null", "nan", "-inf", "1e400", "true", "[1,2]", "{a:1}", "${seed}", "${oc.env:HOME}", "???", "'")
        ),
        draw.choice(
            ("1,2", "range(1,3)", "choice(1,2)", "interval(0,1)", "glob(*)", "[" * 50, "a=b", "\\", "\ud800", "\n")
        ),
    )
    word = f"{key}={draw.choice(values)}"
    kind = draw.randrange(12)
    if kind == 0:
        return mutate.spoil_bytes(draw, word.encode("utf-8", "replace"), b"~seed +x=1 ++seed=2").decode(
            "utf-8", "surrogateescape"
        )
    if kind == 1:
        return draw.choice(("~", "+", "++", "-", "--", "@:", "$")) + word
    return word


def use_command_line(given: tuple[str, list[str]]) -> None:
    """Words become checked configurations; nothing is run."""
    from warpvox.cli.config import expand, load, read_arguments

    command, words = given
    arguments = read_arguments(words)
    for overrides in expand(arguments, command)[:3]:
        load(command, overrides, arguments.config_dir)


TASK = """
from dataclasses import replace
from warpvox.envs.registry import get_task
MINE = replace(get_task("Walker-v0"), id="Mine-v0")
"""


def task_file(draw: Draw) -> tuple[bytes, str]:
    """A file of the user's with a task, and the name to look for."""
    endings = (
        b"",
        b"\nMINE = 5",
        b"\nraise KeyError('x')",
        b"\nimport nowhere",
        b"\nMINE = None",
        b"\n1/0",
        b"\ndef f(): f()\nf()",
        b"\nMINE = replace(MINE, id=5)",
        b"\nMINE = replace(MINE, objects=3)",
        b"\nraise SystemExit(3)",
        b"\n\0",
    )
    data = TASK.encode() + draw.choice(endings)
    if draw.random() < 0.5:
        data = mutate.spoil_bytes(draw, data)
    return data, draw.choice(("MINE", "MINE", "MINE", "mine", "", "__file__", "replace", "MINE:MINE", "\0"))


class TaskFiles:
    """Files of tasks; each has a name of its own, because a file is imported once."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.count = folder, 0

    def use(self, given: tuple[bytes, str]) -> None:
        """The task, and a world of it."""
        from warpvox.envs.registry import get_task
        from warpvox.envs.worlds import task_world

        data, name = given
        self.count += 1
        path = self.folder / f"task_{self.count}.py"
        path.write_bytes(data)
        with contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):
            task = get_task(f"{path}:{name}")
        task_world(task, np.array([[3]], np.int8))


# ------------------------------------------------------------------------------------------------------ editor


def document(draw: Draw) -> dict[str, Any]:
    """A document of the editor."""
    if draw.random() < 0.5:
        rows = draw.choice(design_arrays()).tolist()
        return {"kind": "body", "names": ["robot"], "types": rows, "owners": [[0] * len(rows[0]) for _ in rows]}
    return {
        "kind": "world",
        "names": ["robot", "ground"],
        "types": [[0, 3, 4, 0], [0, 0, 0, 0], [5, 5, 5, 5]],
        "owners": [[0, 0, 0, 0], [0, 0, 0, 0], [1, 1, 1, 1]],
    }


def ask(draw: Draw) -> tuple[str, dict]:
    """An action of the editor and its question."""
    action = draw.choice(("check", "save", "open", "files", "sample", "rollout"))
    question = {"document": document(draw), "name": draw.choice(("one", "two.json", "ä")), "overwrite": True}
    question |= {"rows": 3, "columns": 4, "agent": "sine", "seconds": 0.04, "seed": 1, "task": "Walker-v0"}
    return action, mutate.spoil_tree(draw, question)


METHODS = ("POST", "POST", "POST", "GET", "PUT", "post", "X" * 70000)


def request(draw: Draw) -> tuple[str, bytes]:
    """A request as it goes over the wire, with TOKEN and PORT where the server's belong."""
    action, question = ask(draw)
    if action == "rollout":
        action = "check"  # simulating is tried without the wire
    body = mutate.as_json(draw, question)
    if draw.random() < 0.3:
        body = mutate.spoil_bytes(draw, body)
    length = draw.choice(
        (*[str(len(body))] * 6, "-1", "²", "9" * 5000, "", "1e3", "0x10", str(len(body) + 10), "10000000")
    )
    head = (
        f"{draw.choice(METHODS)} /TOKEN/{action} HTTP/1.1\r\n"
        f"Host: 127.0.0.1:PORT\r\nContent-Type: application/json\r\nContent-Length: {length}"
        "\r\nConnection: close\r\n\r\n"
    ).encode("latin-1", "replace")
    if draw.random() < 0.4:
        head = mutate.spoil_bytes(draw, head, b"GET /rollout/1 HTTP/1.1\r\nHost: \xff\r\nOrigin: null\r\n\r\n")
    return action, head + body


class Editor:
    """The editor's server on this machine, and its actions without the wire."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.failures: list[BaseException] = []

    @cached_property
    def server(self) -> Any:
        """The server, which notes what a request makes it fail with."""
        import sys

        from warpvox.editor.server import EditorServer

        failures = self.failures

        class Noting(EditorServer):
            def handle_error(self, request: Any, client_address: Any) -> None:
                error = sys.exc_info()[1]
                if not isinstance(error, ConnectionError):
                    failures.append(error)

        server = Noting(self.folder)
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        return server

    def close(self) -> None:
        """Stop the server."""
        if "server" in self.__dict__:
            self.server.shutdown()
            self.server.server_close()

    def use_request(self, given: tuple[str, bytes]) -> None:
        """Every request is answered, or the line is closed, and the server lives."""
        _, data = given
        data = data.replace(b"TOKEN", self.server.token.encode()).replace(b"PORT", str(self.server.port).encode())
        with socket.create_connection(("127.0.0.1", self.server.port), timeout=5) as line:
            with contextlib.suppress(OSError):  # it may have closed the line already
                line.sendall(data)
                line.shutdown(socket.SHUT_WR)
            answer = b""
            with contextlib.suppress(ConnectionError):
                while part := line.recv(65536):
                    answer += part
        if self.failures:
            raise RuntimeError("the server failed") from self.failures.pop()
        if answer and not answer.startswith(b"HTTP/1.1 200"):
            raise ConfigError(f"refused: {answer[:60]!r}")
        if b'"error"' in answer[:400]:
            raise ConfigError("refused with an error of ours")

    def use_ask(self, given: tuple[str, dict]) -> None:
        """An action answers with what JSON can hold."""
        from warpvox.editor.server import ACTIONS

        action, question = given
        if not isinstance(question, Mapping):
            raise ConfigError("the server takes mappings only")
        json.dumps(ACTIONS[action](self.server, dict(question)))

    def targets(self) -> list[Target]:
        """The wire and what lies behind it."""
        import warpvox.envs.vec_env  # noqa: F401 (seconds of imports that are not an input's)

        return [
            Target("editor, HTTP requests", request, self.use_request, weight=20),
            Target("editor, documents", ask, self.use_ask, weight=20),
        ]


def function_targets(folder: Path) -> list[Target]:
    """Those that need no server and no simulation."""
    return [
        Target("load_design", design_words, use_design, weight=60),
        Target("sample_design", sampling, lambda given: fits_or_refused(sample_design(*given)), weight=8),
        Target("World methods", world_calls, use_world, weight=60),
        Target("command line", command_line, use_command_line, weight=8),
        Target("task files", task_file, TaskFiles(folder).use, weight=10),
    ]
