"""The paper's experiments: the genetic algorithm on all tasks, and three searches on ten tasks.

python -m lab.comparison.paper run outputs/paper     # searches without a row in paper_members.csv
python -m lab.comparison.paper add outputs/paper     # rows of those that are finished, into the two tables here
python -m lab.comparison.paper tables                # README.md and its picture from the tables
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import warpvox as wv
from lab.comparison.report import draw_panels, write_csv
from lab.comparison.run import Member, add_options, finished, named_settings, run_given
from lab.comparison.statistics import improvement, interquartile_mean, interval, interval_text
from warpvox.algos.report.members import read_members
from warpvox.envs.registry import known_returns

HERE = Path(__file__).resolve().parent
README, CHART = HERE / "README.md", HERE / "paper.svg"
MEMBERS, CURVES, SEARCHES = HERE / "paper_members.csv", HERE / "paper_curves.csv", HERE / "searches.csv"

BENCHMARK10 = (
    "Walker-v0", "BridgeWalker-v0", "UpStepper-v0", "Traverser-v0", "Climber-v0", "Carrier-v0", "Thrower-v0",
    "Catcher-v0", "Lifter-v0", "BeamSlider-v0",
)  # fmt: skip
"""Tasks of the paper's main comparison (section B)."""
SLOWEST = "Traverser-v0"
"""Task whose searches take six times as long as others."""
NAMES = {"ga": "GA", "bo_paper": "BO", "cppn_neat": "CPPN-NEAT"}
"""Names of the searches in the paper."""
SEEDS = 3
SETTINGS = {"training": "fast", "training.iterations": 60}
"""Settings of each design's training: 122,880 control steps. The paper's 512,000 would leave only 39 designs."""
STEPS = 20_000_000
"""Budget of a search in control steps."""
DESIGNS = STEPS // 122_880
FRACTIONS = [part / 20 for part in range(1, 21)]
KEY = ("task", "search", "seed")
FACTS = ("evaluations", "control_steps", "generations", "return", "noise", "seconds", "processor", "commit")
"""Columns of results: ``return`` of the best design in exact arithmetic, ``noise`` its mean under action noise."""
AXES = ("control_steps", "evaluations")
CURVE_COLUMNS = (*KEY, "axis", *map("{:g}".format, FRACTIONS))
"""Columns with the best fitness so far at fractions of the budget, in control steps or evaluations."""
EPISODES = 32

Row = dict[str, str]


def members() -> list[Member]:
    """List all design searches in the order of running, so that an early stop leaves comparable results."""
    found = []
    for seed in range(SEEDS):
        for task in BENCHMARK10:
            for search in NAMES:
                found.append(Member(task, search, seed, named_settings(task, search, DESIGNS, SETTINGS)))
        for task in wv.task_ids():
            if task not in BENCHMARK10:
                found.append(Member(task, "ga", seed, named_settings(task, "ga", DESIGNS, SETTINGS)))
    return sorted(found, key=lambda one: one.task == SLOWEST)


def read_rows(path: Path) -> list[Row]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def keys_of(rows: Sequence[Row]) -> set[tuple[str, str, int]]:
    return {(row["task"], row["search"], int(row["seed"])) for row in rows}


def add(home: Path) -> int:
    """Evaluate the best designs of finished searches without a row and add the rows; return their number."""
    known = keys_of(read_rows(MEMBERS))
    new = [m for m in members() if (m.task, m.search, m.seed) not in known and finished(m.folder(home))]
    for member in new:
        folder = member.folder(home)
        returns = {}
        for protocol in ("nominal", "noise"):
            (row,) = wv.evaluate(
                str(folder), protocol=protocol, episodes=EPISODES, dtype="float64", arithmetic="exact", device="cpu"
            )
            returns[protocol] = row.mean
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        names = {"control_steps": "steps", "seconds": "elapsed_seconds"}
        facts = {name: summary.get(names.get(name, name)) for name in FACTS}
        facts |= {"return": round(returns["nominal"], 9), "noise": round(returns["noise"], 9)}
        (search,) = read_members([folder])
        by_axis = {
            "control_steps": [search.best_at(share * STEPS) for share in FRACTIONS],
            "evaluations": [search.best[: max(1, int(share * DESIGNS + 1e-9))].max() for share in FRACTIONS],
        }

        key = (member.task, member.search, member.seed)
        curves: list[Sequence[object]] = [list(row.values()) for row in read_rows(CURVES)]
        curves += [(*key, axis, *(f"{value:.6g}" for value in by_axis[axis])) for axis in AXES]
        write_csv(CURVES, CURVE_COLUMNS, curves)
        rows: list[Sequence[object]] = [list(row.values()) for row in read_rows(MEMBERS)]
        write_csv(MEMBERS, (*KEY, *FACTS), [*rows, (*key, *facts.values())])
    return len(new)


def page(text: str) -> str:
    """Insert the tables into a page's text, between its marks."""
    returns = returns_of(read_rows(MEMBERS))
    parts = {"ga": ga_table(returns), "compared": compared_table(returns), "searches": searches_table()}
    for name, lines in parts.items():
        mark = re.compile(f"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        text = mark.sub(lambda match, lines=lines: "\n".join([match[1], *lines, "", match[2]]), text)
    return text


def returns_of(rows: Sequence[Row]) -> dict[tuple[str, str], np.ndarray]:
    """Collect returns ``[seeds, 2]``, nominal and under noise, by task and search."""
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in rows:
        found.setdefault((row["task"], row["search"]), []).append((float(row["return"]), float(row["noise"])))
    return {key: np.array(values) for key, values in found.items()}


def ga_table(returns: Mapping[tuple[str, str], np.ndarray]) -> list[str]:
    lines = ["| task | nominal | under noise | best published | by |", "|---|---:|---:|---:|---|"]
    for task, known in known_returns().items():
        runs = returns[task, "ga"]
        cells = [f"{values.mean():.3f} ({values.min():.3f} to {values.max():.3f})" for values in runs.T]
        published = "" if known.best is None else f"{known.best:g}"
        lines.append(f"| {task} | {' | '.join(cells)} | {published} | {known.method} |")
    return lines


def compared_table(returns: Mapping[tuple[str, str], np.ndarray]) -> list[str]:
    """Build the table of three searches on ten tasks: means, scores, and number of tasks won."""
    names = list(NAMES.values())
    heads = [*names, *(f"{name} under noise" for name in names)]
    lines = [f"| task | {' | '.join(heads)} |", f"|---{'|---:' * len(heads)}|"]
    wins = np.zeros((2, len(names)), int)
    scores: list[tuple[dict[str, np.ndarray], dict[str, np.ndarray]]] = [({}, {}) for _ in names]
    for task in BENCHMARK10:
        # Means, nominal first, and the best of each kind
        runs = np.array([returns[task, search] for search in NAMES])
        means = runs.mean(1).T
        best = means == means.max(1, keepdims=True)
        wins += best & (best.sum(1, keepdims=True) == 1)
        cells = [f"**{mean:.3f}**" if top else f"{mean:.3f}" for mean, top in zip(means.flat, best.flat, strict=True)]
        lines.append(f"| {task} | {' | '.join(cells)} |")

        known = known_returns()[task]
        if known.best is not None:
            for number in range(len(names)):
                for judged in range(2):
                    scores[number][judged][task] = np.vectorize(known.score)(runs[number, :, judged])

    lines += [
        "",
        f"The interquartile mean of the scores on the {len(scores[0][0])} of these tasks that have a published return"
        " (0 is chance, 1 that return), and the probability that a run of GA is better, with 95 % bootstrap intervals:",
        "",
        "| search | nominal | under noise | GA better, nominal | GA better, under noise |",
        "|---|---:|---:|---:|---:|",
    ]
    for number, name in enumerate(names):
        cells = [interval_text(interval(interquartile_mean, one)) for one in scores[number]]
        for ga, own in zip(scores[0], scores[number], strict=True):
            cells.append(interval_text(interval(improvement, ga, own)) if number else "")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    (ga, bo, neat), (noisy_ga, noisy_bo, noisy_neat) = wins.tolist()
    lines += [
        "",
        f"GA alone has the highest mean on {ga} of {len(BENCHMARK10)} tasks (BO {bo}, CPPN-NEAT {neat}), under noise on"
        f" {noisy_ga} (BO {noisy_bo}, CPPN-NEAT {noisy_neat}).",
    ]
    return lines


def searches_table() -> list[str]:
    """Build the table of ``ga`` and ``auto``: mean returns by task, and how often ``auto`` wins."""
    known = known_returns()
    found: dict[str, dict[str, dict[int, float]]] = {}
    for row in read_rows(SEARCHES):
        by_search = found.setdefault(row["task"], {"ga": {}, "auto": {}})
        by_search[row["search"]][int(row["seed"])] = float(row["best_fitness"])
    lines = ["| task | `ga` | `auto` | best published |", "|---|---:|---:|---:|"]
    tasks = pairs = better = 0
    for task, by_search in sorted(found.items()):
        cells = []
        for returns in by_search.values():
            each = ", ".join(f"{returns[seed]:.3f}" for seed in sorted(returns))
            cells.append(f"{statistics.fmean(returns.values()):.3f} ({each})")
        lines.append(f"| {task} | {' | '.join(cells)} | {known[task].best:.3f} |")
        ga, auto = by_search["ga"], by_search["auto"]
        tasks += statistics.fmean(auto.values()) > statistics.fmean(ga.values())
        pairs += len(ga.keys() & auto.keys())
        better += sum(auto[seed] > ga[seed] for seed in ga.keys() & auto.keys())
    verdict = f"The mean of `auto` is above that of `ga` on {tasks} of {len(found)} tasks; it is better in {better} of"
    return [*lines, "", f"{verdict} {pairs} pairs with the same task and seed."]


def picture() -> bytes:
    """Draw the best fitness over control steps, one panel per task."""
    panels: dict[str, dict[str, tuple[list[float], np.ndarray]]] = {}
    rows = read_rows(CURVES)
    for task in wv.task_ids():
        panels[task] = {}
        for search, name in NAMES.items():
            mine = [row for row in rows if (row["task"], row["search"], row["axis"]) == (task, search, AXES[0])]
            if mine:
                values = np.array([[float(row[f"{share:g}"]) for share in FRACTIONS] for row in mine])
                panels[task][name] = [share * STEPS for share in FRACTIONS], values
    return draw_panels(panels, list(NAMES.values()))


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    add_options(commands.add_parser("run", help="make searches without a row"))
    commands.add_parser("add", help="add the rows of finished searches").add_argument("folder", type=Path)
    commands.add_parser("tables", help="renew README.md and its picture")
    given = parser.parse_args(words)
    if given.command == "run":
        known = keys_of(read_rows(MEMBERS))
        return run_given([one for one in members() if (one.task, one.search, one.seed) not in known], given)
    if given.command == "add":
        print(f"{add(given.folder)} searches added")
        return 0
    README.write_text(page(README.read_text(encoding="utf-8")), encoding="utf-8")
    CHART.write_bytes(picture())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
