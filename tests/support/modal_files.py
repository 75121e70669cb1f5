"""Files with modes, laid out as their specifications say, and the modes in them."""

import json

import numpy as np

FREQUENCIES = np.array([1.21, 3.47, 5.68])
DAMPING = np.array([0.012, 0.0105, 0.02])
NODES = (1, 7, 12)
# (mode, node): in direction Z only
SHAPES = np.array([[0.33, 0.71, 1.0], [0.88, 0.41, -0.9], [1.0, -0.77, 0.25]])
IMAGINARY = np.array([[0.02, -0.01, 0.03], [-0.04, 0.03, 0.01], [0.03, 0.02, -0.02]])

ID_LINES = ["a frame", "NONE", "23-NOV-26  17:00:00", "NONE", "NONE"]


def integers(*values):
    return "".join(f"{value:10d}" for value in values) + "\n"


def reals(*values):
    """Six columns of 13 characters to a line, as Fortran's 6E13.5."""
    cells = [f"{value:13.5E}" for value in values]
    return "".join("".join(cells[k : k + 6]) + "\n" for k in range(0, len(cells), 6))


def block(number, body):
    return f"    -1\n{number:6d}\n{body}    -1\n"


def node_values(nodes, values):
    """Number and values of each node, real and imaginary part in turn if they are complex."""
    text = ""
    for node, row in zip(nodes, values, strict=True):
        row = np.atleast_1d(row)
        if np.iscomplexobj(row):
            row = np.column_stack([row.real, row.imag]).ravel()
        text += integers(node) + reals(*row)
    return text


def in_z(shape):
    """Values (node, 3) of a shape that moves in Z."""
    return np.column_stack([np.zeros((len(shape), 2)), shape])


def eigenvalue(frequency, damping):
    """-zeta omega + i omega sqrt(1 - zeta^2) [rad/s]."""
    omega = 2.0 * np.pi * frequency
    return omega * complex(-damping, np.sqrt(1.0 - damping**2))


def normal_55(mode, nodes=NODES, values=None, quantity=8, analysis=2, numbers=None):
    """One normal mode as data set 55."""
    values = in_z(SHAPES[mode]) if values is None else values
    count = np.atleast_2d(values).shape[-1]
    body = "".join(line + "\n" for line in ID_LINES)
    body += integers(1, analysis, {1: 1, 3: 2, 6: 3}.get(count, 0), quantity, 2, count)
    body += integers(2, 4, 1, mode + 1)
    body += reals(*(numbers or (FREQUENCIES[mode], 1.0, DAMPING[mode], 0.0)))
    return block(55, body + node_values(nodes, values))


def complex_55(mode, shape=None, of_eigenvalue=None, analysis=3):
    """One complex mode as data set 55."""
    shape = SHAPES[mode] + 1j * IMAGINARY[mode] if shape is None else shape
    pole = eigenvalue(FREQUENCIES[mode], DAMPING[mode]) if of_eigenvalue is None else of_eigenvalue
    body = "".join(line + "\n" for line in ID_LINES)
    body += integers(1, analysis, 2, 12, 5, 3)
    body += integers(2, 6, 1, mode + 1)
    body += reals(pole.real, pole.imag, 1.0, 0.0, 1.0, 0.0)
    return block(55, body + node_values(NODES, in_z(shape)))


def analysis_2414(mode, is_complex=False):
    """One mode as data set 2414."""
    shape = SHAPES[mode] + 1j * IMAGINARY[mode] if is_complex else SHAPES[mode]
    pole = eigenvalue(FREQUENCIES[mode], DAMPING[mode])
    body = integers(mode + 1) + "mode\n" + integers(1) + "".join(line + "\n" for line in ID_LINES)
    body += integers(1, 3 if is_complex else 2, 2, 8, 5 if is_complex else 2, 3)
    body += integers(0, 0, 1, 0, 1, mode + 1, 0, 0) + integers(0, 0)
    if is_complex:
        body += reals(*np.zeros(6)) + reals(pole.real, pole.imag, 0.0, 0.0, 0.0, 0.0)
    else:
        body += reals(0.0, FREQUENCIES[mode], 0.0, 1.0, DAMPING[mode], 0.0) + reals(*np.zeros(6))
    return block(2414, body + node_values(NODES, in_z(shape)))


def geometry_15():
    """Nodes, which a file with modes has above them."""
    lines = [integers(node, 0, 0, 8).rstrip("\n") + reals(node, 0.0, 0.0) for node in NODES]
    return block(15, "".join(lines))


def trace_82():
    """Lines between nodes, with a -1 in its data that ends nothing."""
    return block(82, integers(1, 4, -1) + "line\n" + integers(1, 7, 0, 12) + integers(-1))


UNIVERSAL = geometry_15() + trace_82() + "".join(normal_55(mode) for mode in range(3))
UNIVERSAL_COMPLEX = geometry_15() + "".join(complex_55(mode) for mode in range(3))

TABLE = "mode,frequency [Hz],frequency_sd,damping,floor 1,floor 1_sd,roof\n" + "".join(
    f"{k + 1},{FREQUENCIES[k]},0.0{k + 1},{DAMPING[k]},{SHAPES[k, 0]},0.1{k},{SHAPES[k, 2]}\n"
    for k in range(3)
)

VARIABLES = {"frequency": FREQUENCIES, "damping": DAMPING, "shapes": SHAPES.T}
COMPLEX_VARIABLES = {"omega": 2.0 * np.pi * FREQUENCIES, "shapes": (SHAPES + 1j * IMAGINARY).T}
JSON = json.dumps(
    {name: values.tolist() for name, values in VARIABLES.items()} | {"channels": ["a", "b", "c"]}
)
