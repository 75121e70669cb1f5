"""Tables of what is refused."""

import pytest


def refusals(names, values, types=None):
    """Parametrize by tables {what is said: case}, of wrong values and, where given, of wrong types.

    A case goes to the arguments `names` and what is said to `match`; where there are two tables, the class of
    the error goes to `error`.
    """
    names, rows = names.split(), []
    for error, table in ((ValueError, values), (TypeError, types or {})):
        for match, case in table.items():
            errors = [] if types is None else [error]
            rows.append([*([case] if len(names) == 1 else case), *errors, match])
    columns = [*names, *([] if types is None else ["error"]), "match"]
    return pytest.mark.parametrize(columns, rows, ids=[row[-1] for row in rows])
