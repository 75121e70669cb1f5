"""The first row of numbers: a spoilt one must not pass for a line of the header."""

from pymc_features.io.reading.lines import not_a_number, to_number


def refuse_spoilt_first(file: str, above: list[tuple[int, list[str]]], first: int, n_columns: int) -> None:
    """Refuse a row among the lines above the numbers that is one of them, but for a cell.

    Its first cell is a number in as many columns; or it is illegible, and numbers with a decimal point are
    half of the cells below the labels, or all but one right above the numbers.

    Parameters
    ----------
    file : str
        Its name.
    above : list of (int, list of str)
        Number and cells of each line above the numbers that has no comment sign.
    first : int
        Line number of the first row of numbers.
    n_columns : int
        Of the numbers.

    Raises
    ------
    ValueError
        If there is such a row; the message names the line and the cell.
    """
    below_labels = False
    for number, cells in above:
        numbers = [cell for cell in cells if to_number(cell) is not None]
        measured = sum("." in cell for cell in numbers)
        begins = len(cells) == n_columns > 1 and to_number(cells[0]) is not None
        illegible = not cells[0] or cells[0][0] in "0123456789.+-"
        most = below_labels and 2 * measured >= len(cells)
        almost_all = number == first - 1 and 1 < n_columns <= measured + 1
        if begins or illegible and (most or almost_all):
            raise not_a_number(f"{file}, line {number}", next(c for c in cells if to_number(c) is None))
        below_labels |= len(cells) == n_columns and not numbers
