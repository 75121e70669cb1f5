"""Answers that took long to find: read from and written to `answers.json`."""

import json
from pathlib import Path

import numpy as np

from benchmarks.known.answer import Answer

FILE = Path(__file__).with_name("answers.json")
COMMAND = "python -m benchmarks.known.exact NAME..."


def entries(file=FILE):
    """All entries, {name: dict}."""
    return json.loads(file.read_text())["posteriors"] if file.exists() else {}


def saved_answer(name, file=FILE):
    """The answer of a name; NaN in its place if it has not been found yet."""
    entry = entries(file).get(name)
    if entry is None:
        return Answer([], np.full((3, 0), np.nan), np.nan, np.full((3, 0), np.nan), np.nan, "not found yet")
    return Answer(
        entry["labels"],
        np.array(entry["quantiles_5_50_95"]),
        entry["log_evidence"],
        np.array(entry["quantile_se"]),
        entry["log_evidence_se"],
        entry["note"],
    )


def rounded(value, digits=9):
    """Numbers with nine significant digits, inside lists and dictionaries too; standard errors with three."""
    if isinstance(value, dict):
        return {key: rounded(v, 3 if key.endswith("_se") else digits) for key, v in value.items()}
    if isinstance(value, list):
        return [rounded(v, digits) for v in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def save(name, entry, file=FILE):
    """Add or replace an entry; names are sorted, and the file changes in one step."""
    found = rounded({**entries(file), name: entry})
    lines = [f"    {json.dumps(key)}: {json.dumps(found[key])}" for key in sorted(found)]
    text = f'{{\n  "made_by": {json.dumps(COMMAND)},\n  "posteriors": {{\n' + ",\n".join(lines) + "\n  }\n}\n"
    partial = file.with_suffix(".partial")
    partial.write_text(text)
    partial.replace(file)
