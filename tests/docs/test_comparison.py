"""The comparison of searches is what its command makes of the committed rows, and these what suites have found."""

import json
from pathlib import Path

import comparison


def test_the_page_is_up_to_date() -> None:
    text = comparison.PAGE.read_text(encoding="utf-8")
    assert comparison.BEGIN in text
    assert text == comparison.page(text, comparison.read_table(comparison.TABLE)), "run `python docs/comparison.py`"


def test_rows_of_suites_replace_each_other(tmp_path: Path) -> None:
    lines = ["task,search,seed,state,evaluations,control_steps,wall_s,best_fitness,folder,error"]
    for seed, state, fitness in (0, "done", "1.23456789"), (1, "done", "2"), (2, "running", "9"):
        lines.append(f"Walker-v0,auto,{seed},{state},10,5000,60.5,{fitness},members/{seed},")
        (tmp_path / "members" / str(seed)).mkdir(parents=True)
        (tmp_path / "members" / str(seed) / "summary.json").write_text(json.dumps({"commit": "abc"}), encoding="utf-8")
    (tmp_path / "members.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    known = [
        dict.fromkeys(comparison.COLUMNS, "") | {"search": name, "task": "Walker-v0", "seed": "0", "best_fitness": "1"}
        for name in ("auto", "ga")
    ]
    rows = comparison.with_suite(known, tmp_path)
    assert [(row["search"], row["seed"], row["best_fitness"]) for row in rows] == [
        ("auto", "0", "1.23457"),
        ("auto", "1", "2"),
        ("ga", "0", "1"),
    ]
    assert (rows[0]["commit"], rows[0]["control_steps"]) == ("abc", "5000")
    text = comparison.table(rows)
    assert "| task | `ga` | `auto` | best published |" in text
    assert "| Walker-v0 | 1.000 (1.000) | 1.617 (1.235, 2.000) | 10.598 |" in text
    assert "in 1 of 1 tasks; it is better in 1 of 1 pairs" in text
