"""Tests that the results page equals its generator's output."""

import dataclasses
import re

import numpy as np
import pytest
from PIL import Image
from scipy import stats

from lab.zoo import results
from lab.zoo.picture import draw_zoo
from warpvox import task_ids, zoo
from warpvox.algos.robots import Robot, zoo_tasks
from warpvox.envs.registry import known_returns

DOCS = results.PAGE.parent


def test_the_page_is_up_to_date_and_readme_says_what_it_says() -> None:
    text, robots = (DOCS / "results.md").read_text(encoding="utf-8"), [*map(zoo, task_ids())]
    disturbed, repeated = map(results.read_table, (results.DISTURBED, results.REPEATED))
    assert text == results.page(robots, disturbed, repeated), "run `python -m lab.zoo.results`"
    readme = " ".join((DOCS.parent / "README.md").read_text(encoding="utf-8").split())
    summary = " ".join(results.summary(robots, disturbed).split())
    assert summary in readme
    held = re.search(r"(\d+ of \d+) robots match or beat the best published return", summary)
    assert f"**{held[1]}** robots match or beat the best published return" in (DOCS / "index.md").read_text(
        encoding="utf-8"
    )


def test_the_page_of_evaluation_shows_what_is_recorded() -> None:
    page = (DOCS / "evaluation.md").read_text(encoding="utf-8")
    rows = [row for row in results.read_table(results.DISTURBED) if row["task"] == "UpStepper-v0"]
    for row in rows:
        assert "| {episodes} | {mean} | {low} to {high} | {quantile_10} |".format(**row) in page
    assert f"| nominal | {zoo('UpStepper-v0').mean_return:.3f} |" in page


def test_the_table_of_protocols_is_about_the_robots_of_the_zoo() -> None:
    rows = results.read_table(results.DISTURBED)
    means = {row["task"]: float(row["mean"]) for row in rows if row["episodes"] == "noise"}
    assert means == {task: pytest.approx(zoo(task).robust_return, abs=5e-4) for task in zoo_tasks()}
    with_sensors = {row["task"] for row in rows if row["episodes"] == "sensors"}
    assert with_sensors == {task for task in zoo_tasks() if zoo(task).has_feedback}


BEST = known_returns()["Walker-v0"].best
ABOUT = {"control_steps": 2000, "wall_s": 7500.0}


def made(nominal: float, noisy: float, task: str = "Walker-v0") -> Robot:
    return dataclasses.replace(zoo(task), about=ABOUT | {"return": nominal, "noise": {"return": noisy}})


def cells(robot: Robot) -> list[str]:
    mean = robot.robust_return
    row = {"task": robot.task, "episodes": "noise", "mean": str(mean), "high": str(mean + 0.25)}
    text = results.page([robot], [row], [])
    return next(line for line in text.splitlines() if line.startswith(f"| {robot.task} | "))[2:-2].split(" | ")


@pytest.mark.parametrize(("shift", "bold"), [(0.0, "**"), (-0.5, "")])
def test_returns_are_bold_from_the_best_published_one_on(shift: float, bold: str) -> None:
    robot = made(BEST + shift, BEST + shift)
    best = f"{BEST:g}, {known_returns()['Walker-v0'].method}"
    assert cells(robot)[1:] == [f"{bold}{BEST + shift:.3f}{bold} ± 0.250", best, "network"]
    assert f"noise, {1 if bold else 0} of 1 robots match" in " ".join(results.summary([robot], []).split())


def test_robots_without_a_published_return_and_gaits_are_told_apart() -> None:
    assert cells(made(1.0, 1.0, "Traverser-v0"))[1:] == ["1.000 ± 0.250", "none", "network"]
    assert cells(made(1.0, 1.0, "Climber-v0"))[3] == "gait"
    robots = [made(99, 99, name) for name in ("Traverser-v0", "Climber-v0", "Walker-v0", "Pusher-v0")]
    rows = [
        {"task": task, "episodes": part, "mean": mean}
        for task, part, mean in (
            ("Traverser-v0", "sticky", "99"), ("Climber-v0", "sticky", "99"), ("Walker-v0", "sticky", "10.6"),
            ("Walker-v0", "start", "10.5"), ("Pusher-v0", "sensors", "99"),
        )
    ]  # fmt: skip
    text = " ".join(results.summary(robots, rows).split())
    assert "3 of 3 robots match" in text
    assert "2 networks with feedback and 1 open-loop gaits (fixed rhythms without feedback)" in text
    assert "repeated at random, 2 do; if episodes begin with random actions, 0." in text


def test_the_mean_of_five_trainings_leaves_the_best_and_the_worst_out() -> None:
    five = [{"task": "Walker-v0", "noise": str(value)} for value in (9.0, 1.0, 4.0, -50.0, 2.5)]
    assert results.repeated_means(five) == {"Walker-v0": 2.5}
    assert results.repeated_means(five[:-1]) == {}


def test_the_zoo_has_no_worse_robot_than_the_best_of_the_repeated_trainings() -> None:
    repeated: dict[str, dict[str, float]] = {}
    for row in results.read_table(results.REPEATED):
        repeated.setdefault(row["task"], {})[row["seed"]] = float(row["noise"])
    for task, means in repeated.items():
        assert len(means) == results.RUNS
        returns = zoo(task).about["noise"]["returns"]
        half = stats.sem(returns) * stats.t.ppf(0.975, len(returns) - 1)  # a lead within the interval may be chance
        assert max(means.values()) <= np.mean(returns) + half + 1e-3 * abs(np.mean(returns)), task


def test_rows_of_a_robot_in_disturbed_episodes_are_those_of_the_table() -> None:
    known = [row for row in results.read_table(results.DISTURBED) if row["task"] == "Balancer-v0"]
    assert results.disturbed_rows("Balancer-v0") == known


def test_films_are_drawn(tmp_path) -> None:
    draw_zoo(tmp_path, ["Balancer-v0"])
    for name in "zoo", "tasks/Balancer-v0":
        with Image.open(tmp_path / f"{name}.webp") as film:
            assert film.n_frames > 1
