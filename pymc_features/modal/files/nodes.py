"""Places of the degrees of freedom of a structure, for drawings of its modes."""

from pathlib import Path

import numpy as np
import pandas as pd

from pymc_features._checks import require, shown

AXES = ("x", "y", "z")
COLUMNS = ("dof", "name", *AXES, "direction", "line")


def read_nodes(path: Path, channels: dict[str, int], n_dof: int) -> tuple[np.ndarray, dict]:
    """Read the nodes of a structure; `channels` are names to degrees of freedom, of which there are `n_dof`.

    Returned are the degree of freedom of each point, -1 of one that is held, and what `plots.mode_shapes`
    takes as `nodes`.

    The file is a CSV with the columns `dof`, from 0, or `name`, of a channel; `x`, `y`, `z` [m], zero where a
    column is missing; `direction`, x, y or z, perhaps with a minus, in which the degree of freedom moves; and
    `line`: rows that are equal there are joined in their order. Without a degree of freedom a node is held.
    """
    require(path.is_file(), f"`nodes` must be an existing file, got {path}. Leave it out for storeys.")
    try:
        rows = pd.read_csv(path, dtype=str, keep_default_na=False, index_col=False, encoding="utf-8-sig")
    except ValueError as error:
        raise ValueError(f"`nodes` must be a CSV file, got {path.name}: {error}.") from error
    rows = rows.rename(columns=str.strip).fillna("").apply(lambda column: column.str.strip())
    got = f"{shown(', '.join(rows))} in {path.name}."
    what = f"the columns dof or name, x, y, z, and perhaps direction and line, got {got}"
    are_known = {*rows} <= {*COLUMNS} and len({"dof", "name"} & {*rows}) == 1
    require(are_known, f"`nodes` must have {what}")
    require({*AXES} & {*rows}, f"`nodes` must have a column x, y or z, got none in {path.name}.")

    def refuse(key, is_wrong, words, advice=""):
        for at in np.flatnonzero(is_wrong):
            where, got = f"{path.name}, line {at + 2}", shown(rows[key][at])
            raise ValueError(f"`nodes`, {where}: `{key}` must be {words}, got {got}. {advice}".strip())

    if "name" in rows:
        words = f"one of the channels {', '.join(channels)}"
        refuse("name", ~rows["name"].isin(["", *channels]), words, "Use a column `dof` for others.")
        dofs = rows["name"].map(channels)
    else:
        words = f"a whole number from 0 to {n_dof - 1}, or empty where a node is held"
        refuse("dof", ~rows["dof"].isin(["", *map(str, range(n_dof))]), words)
        dofs = pd.to_numeric(rows["dof"], errors="coerce")
    columns = {"dof": dofs.fillna(-1).astype(int)}
    for axis in AXES:
        columns[axis] = pd.to_numeric(rows.get(axis, pd.Series(0.0, rows.index)), errors="coerce")
        refuse(axis, ~np.isfinite(columns[axis]), "a number in m")
    if "direction" in rows:
        along, is_held = rows["direction"].str.lstrip("+-"), columns["dof"] < 0
        refuse("direction", ~along.isin(AXES) & ~((along == "") & is_held), "x, y, z or -x, -y, -z")
        sign = np.where(rows["direction"].str.startswith("-"), -1.0, 1.0)
        columns |= {f"along {axis}": sign * (along == axis) for axis in AXES}
    table = pd.DataFrame(columns)
    points, numbers = table.drop_duplicates(), table.groupby([*table], sort=False).ngroup()
    for name, dof in channels.items():
        what = f"{path.name} has none for {name} (degree of freedom {dof}). Add it."
        require(dof in points["dof"].values, f"`nodes` must have a row for every channel, {what}")
    lines = numbers.groupby(rows.get("line", pd.Series("", rows.index)), sort=False).agg(list).tolist()
    nodes = {"coordinates": list(points[[*AXES]].itertuples(index=False, name=None)), "lines": lines}
    if "direction" in rows:
        of_axes = points[[f"along {axis}" for axis in AXES]]
        nodes["directions"] = list(of_axes.itertuples(index=False, name=None))
    return points["dof"].values, nodes
