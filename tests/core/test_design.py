import itertools
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from damage import Stranger
from flood import pieces
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

import warpvox as wv
from warpvox.design import are_valid, full_connections, repair_design
from warpvox.evogym.utils import is_connected

GRIDS = hnp.arrays(np.int8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=7), elements=st.integers(0, 4))
# Mostly filled: random grids of this size are hardly ever connected.
CELLS = st.sampled_from([1, 2, 3, 4, 3, 4, 2, 1, 0])
DENSE = hnp.arrays(np.int8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=6), elements=CELLS)


def is_valid(grid: np.ndarray) -> bool:
    return pieces(grid) == 1 and bool(((grid == 3) | (grid == 4)).any())


@given(GRIDS | DENSE)
def test_connectivity_equals_a_flood_fill(grid: np.ndarray) -> None:
    assert is_connected(grid) is (pieces(grid) == 1)  # a bool: scripts ask `is False`


@given(hnp.arrays(np.int8, st.tuples(st.integers(0, 6), st.integers(1, 6), st.integers(1, 6)), elements=CELLS))
def test_bodies_of_a_batch_are_judged_apart(bodies: np.ndarray) -> None:
    assert are_valid(bodies).tolist() == [is_valid(body) for body in bodies]


@given(GRIDS | DENSE)
def test_check_design_accepts_exactly_the_valid_bodies(grid: np.ndarray) -> None:
    if is_valid(grid):
        body = wv.check_design(grid.astype(float))
        assert body.dtype == np.int8
        assert np.array_equal(body, grid)
        assert np.array_equal(wv.check_design(grid.tolist()), grid)
        assert not np.shares_memory(wv.check_design(grid), grid)
    else:
        with pytest.raises(wv.DesignError):
            wv.check_design(grid)


@given(GRIDS)
def test_full_connections_are_all_neighbours_in_row_major_order(grid: np.ndarray) -> None:
    rows, columns = grid.shape
    expected = []
    for r, c in itertools.product(range(rows), range(columns)):
        for rr, cc in ((r, c + 1), (r + 1, c)):
            if rr < rows and cc < columns and grid[r, c] and grid[rr, cc]:
                expected.append([r * columns + c, rr * columns + cc])
    pairs = full_connections(grid)
    assert pairs.dtype == np.int32
    assert pairs.shape == (len(expected), 2)
    assert pairs.tolist() == expected


@given(st.tuples(st.integers(1, 6), st.integers(1, 6)), st.integers(0, 2**32 - 1))
def test_samples_are_valid_and_reproducible(shape: tuple[int, int], seed: int) -> None:
    body = wv.sample_design(shape, seed)
    assert body.shape == shape
    assert body.dtype == np.int8
    assert is_valid(body)
    assert np.array_equal(body, wv.sample_design(shape, seed))


def test_a_generator_is_continued() -> None:
    rng = np.random.default_rng(5)
    first, second = wv.sample_design(seed=rng), wv.sample_design(seed=rng)
    assert np.array_equal(first, wv.sample_design(seed=5))
    assert not np.array_equal(first, second)


def chi_square(counts: dict[tuple[int, ...], int], law: dict[tuple[int, ...], float]) -> float:
    """Pearson's statistic in standard deviations from its mean: k - 1 with variance 2 (k - 1)."""
    total = sum(counts.values())
    statistic = sum((counts[body] - total * p) ** 2 / (total * p) for body, p in law.items())
    return (statistic - (len(law) - 1)) / np.sqrt(2 * (len(law) - 1))


def test_samples_follow_the_law_of_independent_cells_given_validity() -> None:
    weights = np.array([0.6, 0.2, 0.2, 0.2, 0.2])
    law = {
        cells: float(np.prod(weights[list(cells)]))
        for cells in itertools.product(range(5), repeat=4)
        if is_valid(np.reshape(cells, (2, 2)))
    }
    total = sum(law.values())
    law = {cells: p / total for cells, p in law.items()}
    rng = np.random.default_rng(0)
    counts = Counter(tuple(wv.sample_design((2, 2), rng).ravel().tolist()) for _ in range(8000))
    assert set(counts) <= set(law)
    # 4 standard deviations: fails by chance once in about 10,000 seeds, and the seed is fixed
    assert chi_square(counts, law) < 4.0


def test_examples_are_valid_distinct_and_fresh() -> None:
    examples = wv.example_designs()
    assert examples["walker"].tolist() == [
        [1, 4, 4, 4, 1],
        [3, 3, 3, 3, 3],
        [3, 3, 3, 3, 3],
        [4, 4, 0, 4, 4],
        [4, 4, 0, 4, 4],
    ]
    assert len({body.tobytes() for body in examples.values()}) == len(examples)
    for name, body in examples.items():
        assert np.array_equal(wv.check_design(body), wv.example_design(name))
        body[:] = 0
        assert wv.example_design(name).any()


@given(DENSE.filter(is_valid), st.sampled_from([".json", ".npz", ".npy", ".NPZ", ".Npy"]))
def test_files_round_trip(tmp_path_factory: pytest.TempPathFactory, body: np.ndarray, suffix: str) -> None:
    path = wv.save_design(tmp_path_factory.mktemp("designs") / f"body{suffix}", body)
    for spec in (path, str(path)):
        loaded = wv.load_design(spec)
        assert loaded.dtype == np.int8
        assert np.array_equal(loaded, body)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_the_npz_file_is_evogyms_structure_file(tmp_path: Path) -> None:
    body = wv.example_design("mini")
    with np.load(wv.save_design(tmp_path / "s.npz", body)) as archive:
        assert archive.files == ["arr_0", "arr_1"]
        assert np.array_equal(archive["arr_0"], body)
        assert archive["arr_1"].shape == (2, len(full_connections(body)))
    # as EvoGym's own scripts write it: floating-point cells
    np.savez(tmp_path / "theirs.npz", body.astype(float), full_connections(body).T)
    assert np.array_equal(wv.load_design(tmp_path / "theirs.npz"), body)


def test_load_design_understands_names_random_text_and_arrays() -> None:
    assert np.array_equal(wv.load_design("hopper"), wv.example_design("hopper"))
    assert np.array_equal(wv.load_design("random", seed=3), wv.sample_design((5, 5), 3))
    assert np.array_equal(wv.load_design("random:3x7", seed=3), wv.sample_design((3, 7), 3))
    assert wv.load_design("[[3, 3], [4, 4]]").tolist() == [[3, 3], [4, 4]]
    assert wv.load_design([[3, 3], [4, 4]]).tolist() == [[3, 3], [4, 4]]


@given(bodies=st.lists(DENSE.filter(is_valid), min_size=1, max_size=2), rows=st.integers(1, 3))
def test_the_only_robot_of_a_world_is_a_body(
    bodies: list[np.ndarray], rows: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A world as another reader, :class:`warpvox.World`, writes it."""
    world, file = wv.World(60, 60), tmp_path_factory.mktemp("worlds") / "w.json"
    world.add_from_array("ground", np.full((1, 50), 5), 0, 0)
    for number, body in enumerate(bodies):
        world.add_from_array(f"robot{number}", body, 2 + 20 * number, rows)
    world.to_json(file)
    if len(bodies) > 1:
        with pytest.raises(wv.DesignError):
            wv.load_design(file)
        return
    filled = np.argwhere(bodies[0])
    (top, left), (bottom, right) = filled.min(0), filled.max(0) + 1
    np.testing.assert_array_equal(wv.load_design(file), bodies[0][top:bottom, left:right])


FORMATS = [
    {"fmt": "%d"},
    {"fmt": "%d", "delimiter": ","},
    {"fmt": "%d", "delimiter": ", "},
    {"fmt": "%d", "delimiter": "\t"},
    {"fmt": "%d", "delimiter": ""},
    {"fmt": "%d", "delimiter": ";", "newline": "\r\n"},
    {"fmt": "%.18e"},
    {"fmt": "%1.1f", "header": "cells 0 1 2, Körper", "footer": "end"},
    {"fmt": "%s", "delimiter": ","},
]
"""Options of numpy.savetxt."""


@given(DENSE.filter(is_valid), st.sampled_from(FORMATS), st.sampled_from([".txt", ".csv", ".dat", ""]), st.booleans())
def test_text_grids_are_bodies(
    tmp_path_factory: pytest.TempPathFactory, body: np.ndarray, options: dict, suffix: str, as_float: bool
) -> None:
    path = tmp_path_factory.mktemp("designs") / f"body{suffix}"
    whole = as_float and "%d" not in options["fmt"]
    np.savetxt(path, body.astype(float) if whole else body, **options)
    for spec in (path, str(path)):
        np.testing.assert_array_equal(wv.load_design(spec), body)


def test_formats_are_known_by_content_under_other_names(tmp_path: Path) -> None:
    body = wv.example_design("mini")
    for suffix in (".json", ".npz", ".npy"):
        other = tmp_path / f"body{suffix}.bak"
        other.write_bytes(wv.save_design(tmp_path / f"body{suffix}", body).read_bytes())
        np.testing.assert_array_equal(wv.load_design(other), body)


def test_folders_hold_bodies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    body, other = wv.example_design("mini"), wv.example_design("worm")
    robot, generation = tmp_path / "robot", tmp_path / "generation_0"
    for folder in (robot, generation / "structure"):
        folder.mkdir(parents=True)
    np.save(robot / "body.npy", body.astype(float))
    np.save(robot / "connections.npy", full_connections(body).T)
    np.savez(generation / "structure" / "0.npz", body, full_connections(body).T)
    (generation / "output.txt").write_text("0\t\t1.5\n")
    for spec in (robot, "robot", "~/robot", "generation_0", generation / "structure"):
        np.testing.assert_array_equal(wv.load_design(spec), body)
    assert len(wv.load_design("mini")) == len(body)

    np.savez(generation / "structure" / "1.npz", other, full_connections(other).T)
    with pytest.raises(wv.DesignError):
        wv.load_design(generation)
    np.save(robot / "connections.npy", full_connections(body)[1:].T)
    with pytest.raises(wv.DesignError):
        wv.load_design(robot)


def test_repaired_bodies_are_valid_and_keep_what_they_can() -> None:
    apart = np.array([[1, 0, 3, 0], [1, 0, 3, 0], [1, 0, 0, 0], [1, 0, 0, 2]])
    bodies = np.random.default_rng(1).integers(0, 5, (300, 3, 4)) * np.random.default_rng(2).integers(0, 2, (300, 3, 4))
    made = np.stack([repair_design(body) for body in bodies])
    fine = are_valid(bodies)
    assert are_valid(made).all()
    assert 0 < fine.sum() < 300
    assert np.array_equal(made[fine], bodies[fine])
    assert ((made == bodies) | (made == 0) | (made == 3)).all()
    assert ((made != bodies) & (made == 3)).sum((1, 2)).max() == 1
    assert repair_design(apart.T).tolist() == np.where(apart == 3, 3, 0).T.tolist()
    with pytest.raises(wv.DesignError):
        repair_design([[7]])


@pytest.mark.parametrize(
    "body",
    [[[1, 3], [7, 1]], [[1, 3.5]], [[3, 3], [5, 3]], [3, 3], np.zeros((0, 5)), [[3, 3], [3]], "walker", Stranger()],
)
def test_what_is_no_body_is_refused_in_a_line(body: object) -> None:
    with pytest.raises(wv.DesignError) as caught:
        wv.check_design(body)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "arguments",
    [
        *({"shape": (0, 5)}, {"seed": -1}, {"shape": (250, 250), "probabilities": [9, 9, 9, 0, 2e-5]}),
        *({"probabilities": given} for given in ([1, 1, 1], [1, 1, 1, 0, 0], [1, 1, float("nan"), 1, 1], [0] * 5, "x")),
    ],
)
def test_sampling_refuses_what_it_cannot_do(arguments: dict[str, object]) -> None:
    with pytest.raises(wv.DesignError):
        wv.sample_design(**arguments)


def test_large_bodies_are_the_largest_piece_of_random_cells() -> None:
    body = wv.sample_design((40, 40), seed=0)
    assert body.shape == (40, 40)
    assert np.count_nonzero(body) > 100
    assert np.array_equal(wv.check_design(body), wv.sample_design((40, 40), seed=0))


@pytest.mark.parametrize(
    "spec",
    ["worn", "random:5", "[[3, 3], [4", "nowhere.json", "x" * 5000 + ".npy", "a\0b.npz", "/dev/zero.npy", "/dev/null"],
)
def test_load_design_refuses_what_it_cannot_read(spec: object) -> None:
    with pytest.raises(wv.DesignError):
        wv.load_design(spec)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", b'{"body": [[1, 2]]}'),
        ("b.json", b'{"grid": []}'),
        ("c.json", b'{"grid_width": 1, "grid_height": 1, "objects": {}}'),
        ("w.json", b'{"grid_width": 0, "objects": {"a": {"indices": [1], "types": [3]}}}'),
        *(("d.json", b"\xff\xfe"), ("f.npz", b"not a zip"), ("a.csv", b"# nothing\n\n")),
        *(("a.txt", content) for content in (b"0 1 3\nwalker\n", b"3 3\n3\n", b"3 6\n", b"3 nan\n")),
        *(("a.png", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"), ("a.gif", b"GIF89a!!"), ("a.pt", b"PK\x03\x04 and more")),
        ("a", b" " * 4_000_001),
    ],
)
def test_bad_files_are_named(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(wv.DesignError) as caught:
        wv.load_design(tmp_path / name)
    assert name in str(caught.value)


@pytest.mark.parametrize(
    ("cells", "pairs"),
    [
        *((np.full((2, 2), 3.0), pairs) for pairs in ([[0, 0], [1, 2]], np.empty((2, 0)), [])),
        *(([[3, 4]], pairs) for pairs in ([[0.0, np.nan]], [[0], [np.nan]], [0, 1], [[[0], [1]]])),
    ],
)
def test_a_structure_file_with_cuts_or_without_pairs_is_refused(tmp_path: Path, cells: object, pairs: object) -> None:
    np.savez(tmp_path / "a.npz", arr_0=cells, arr_1=np.array(pairs))
    with pytest.raises(wv.DesignError):
        wv.load_design(tmp_path / "a.npz")


def test_nothing_is_written_for_a_bad_body_or_suffix(tmp_path: Path) -> None:
    for name, body in (("x.json", [[1]]), ("x.txt", [[3]])):
        with pytest.raises(wv.DesignError):
            wv.save_design(tmp_path / name, body)
    assert not list(tmp_path.iterdir())
    with pytest.raises(wv.DesignError):  # a folder without a design
        wv.load_design(tmp_path)
