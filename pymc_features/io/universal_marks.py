"""Universal Files: data sets between lines of -1, each below its number."""

NAME = "Universal File"
FUNCTIONS = "58"  # the data set of measured functions
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")  # directions 1 to 6


def is_universal(head: bytes) -> bool:
    """Whether a file begins with -1 in columns 5 and 6, and a number that ends in column 6 below it."""
    lines = head.lstrip(b"\r\n").splitlines()[:2]
    if len(lines) < 2 or lines[0].rstrip() != b"    -1":
        return False
    number = lines[1][:6]
    return len(number) == 6 and number.strip().isdigit() and number[-1:].isdigit()


def is_mark(line: str) -> bool:
    """Whether a line begins or ends a data set: -1 in columns 5 and 6."""
    return line[:6].strip() == "-1" and not line[6:].strip()
