"""The modes that an identification found, and how far mode shapes agree."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from pymc_features._checks import (
    as_list,
    as_numbers,
    check_finite,
    check_integer,
    check_title,
    is_number,
    listed,
    message,
    require,
    shown,
    warn_caller,
)
from pymc_features.exceptions import ModalDataWarning

COLLINEAR = 0.9  # modal phase collinearity below which a real shape stands badly for a complex one
AXES = ("mode", "channel", "input")
_SD = 0.0, np.inf, "at least 0, or NaN where it is not known", ". Correct it first."
_RATIO = "fractions from 0 to 1", ". Divide a percentage by 100, and leave out modes of negative damping."
#: Numbers beside frequencies and shapes: axes, least, below what, in words, and what to do.
_NUMBERS = {
    "frequency_sd": ("mode,", 5e-324, np.inf, "positive", " Hz. Leave it out if it is not known."),
    "damping_ratios": ("mode,", 0.0, 1.0, *_RATIO),
    "damping_sd": ("mode,", *_SD),
    "shape_sd": ("mode, channel", *_SD),
    "participation": ("mode, input", -np.inf, np.inf, "finite", ". Leave it out."),
    "participation_sd": ("mode, input", *_SD),
}


@dataclass(frozen=True, eq=False, repr=False)
class ModalData:
    """Modes of a structure as an identification found them, immutable.

    Parameters
    ----------
    frequencies : array_like (m,)
        Natural frequencies [Hz], positive, in any order.
    shapes : array_like (m, s), optional
        Entry of each mode at each channel, real or complex, of any scale; NaN where it was not measured.
    channels : sequence of str (s,)
        Names of the channels, all different; needed with `shapes`.
    frequency_sd : array_like (m,), optional
        Standard deviations of the frequencies [Hz], positive.
    damping_ratios : array_like (m,), optional
        Fractions of critical damping, 0 <= zeta < 1; NaN where it is not known.
    damping_sd : array_like (m,), optional
        Standard deviations of the damping ratios, at least 0; NaN where it is not known.
    shape_sd : array_like (m, s), optional
        Standard deviations of the entries, in the scale of `shapes`, at least 0; NaN where it is not known.
    name : str
        What messages call the modes.
    labels : sequence of str (m,), optional
        Which mode of the structure each is of, equal for several identifications of one.
    inputs : sequence of str (r,), optional
        Names of known excitations, with `participation`.
    participation : array_like (m, r), optional
        By how much each mode follows an excitation x: its acceleration at each channel is the shape times the
        participation times s^2 X / (s^2 + 2 zeta w s + w^2) [1/kg of forces]. Of a motion of the base it is
        the participation factor with the opposite sign.
    participation_sd : array_like (m, r), optional
        Standard deviations of these, at least 0.

    Raises
    ------
    ValueError, TypeError
        If shapes do not fit each other, names are missing or twice there, or numbers are out of range.

    Examples
    --------
    >>> shapes = [[0.6, 1.0], [1.0, -0.5]]
    >>> modal = ModalData([1.2, 3.5], shapes, ["floor 1", "roof"], frequency_sd=[0.01, 0.03])
    >>> modal
    ModalData(2 modes from 1.2 to 3.5 Hz, 2 channels)
    >>> modal.select(channels=["roof"]).shapes
    array([[ 1. ],
           [-0.5]])
    """

    frequencies: np.ndarray = field()
    shapes: np.ndarray | None = None
    channels: tuple[str, ...] = ()
    frequency_sd: np.ndarray | None = None
    damping_ratios: np.ndarray | None = None
    damping_sd: np.ndarray | None = None
    shape_sd: np.ndarray | None = None
    name: str = ""
    labels: np.ndarray | None = None
    inputs: tuple[str, ...] = ()
    participation: np.ndarray | None = None
    participation_sd: np.ndarray | None = None

    def __post_init__(self):
        checks = {"frequencies": self._frequencies, "channels": self._channels, "name": check_title}
        checks |= {"shapes": self._shapes, "labels": self._labels}
        checks["inputs"] = lambda names: tuple(_names(names, "inputs", "names"))
        checks |= {name: partial(self._numbers, name) for name in _NUMBERS}
        for name, check in checks.items():
            value = getattr(self, name)
            if value is not None or name in ("frequencies", "channels", "name"):
                object.__setattr__(self, name, check(value))

    def _frequencies(self, given):
        values = as_numbers(given, "frequencies", "Pass Hz, or read files with `read_modal`.")
        what = "`frequencies` must have shape (m,) with at least one mode"
        demand(values.ndim == 1 and values.size, what, values.shape, "Pass one frequency [Hz] for each mode.")
        check_finite(values, "frequencies", "Leave the mode out.")
        mode = int(np.argmin(values > 0.0))
        got = f"{values[mode]} Hz of mode {mode}"
        demand(values[mode] > 0.0, "`frequencies` must be positive", got, "Leave out modes of a rigid body.")
        return values

    def _labels(self, given):
        what = f"{len(self)} names, one for each mode"
        names = _names(given, "labels", what)
        require(len(names) == len(self), message("labels", what, len(names)))
        return np.array(names)

    def _channels(self, given):
        names = tuple(name.strip() for name in _names(given, "channels", "a sequence of names"))
        got = f"none at index {[*names, ''].index('')}"
        demand("" not in names, "`channels` must have a name each", got)
        twice = [name for name, count in Counter(names).items() if count > 1]
        got = f"{', '.join(twice[:5])} more than once"
        demand(not twice, "`channels` must have different names", got, "Rename or leave out one of each.")
        what = "`channels` must be left out without `shapes`"
        demand(self.shapes is not None or not names, what, f"{len(names)} names", "Pass the shapes too.")
        return names

    def _shapes(self, given):
        values, shape = as_numbers(given, "shapes", allow_complex=True), (len(self), len(self.channels))
        advice = "Pass a name for each channel and a frequency for each mode."
        if values.shape == shape[::-1]:
            advice = "Transpose it: the first axis is the mode."
        is_whole = values.shape == shape and 0 not in shape
        demand(is_whole, f"`shapes` must have shape (mode, channel) = {shape}", values.shape, advice)
        what = "`shapes` must be finite, or NaN where nothing was measured"
        demand(not np.isinf(values).any(), what, "infinity", "Correct it first.")
        moving = without_nan(values).any(axis=1)
        mode = int(np.argmin(moving))
        got = f"none in mode {mode} ({self.frequencies[mode]:.4g} Hz)"
        what = "`shapes` must have an entry that is not zero in each mode"
        demand(moving[mode], what, got, "Leave the mode out.")
        return values

    def _numbers(self, name, given):
        values = check_numbers(given, name, len(self), len(self.channels), len(self.inputs))
        if name == "frequency_sd":
            check_finite(values, name, "Leave it out if some are not known.")
        return values

    def __repr__(self):
        f = self.frequencies
        modes = "1 mode of" if f.size == 1 else f"{f.size} modes from {f.min():.4g} to"
        label = f"{self.name!r}, " if self.name else ""
        count = len(self.channels)
        kind = "" if self.shapes is None else f", {count} channel{'s' if count > 1 else ''}"
        return f"ModalData({label}{modes} {f.max():.4g} Hz{kind}{', complex' if self.is_complex else ''})"

    def __len__(self):
        return self.frequencies.size

    def __reduce__(self):
        # made anew, so that the arrays of a deep or pickled copy are read-only as well
        return type(self), tuple(getattr(self, entry.name) for entry in fields(self))

    @property
    def is_complex(self) -> bool:
        """Whether the shapes are complex."""
        return self.shapes is not None and self.shapes.dtype.kind == "c"

    @property
    def phase_collinearity(self) -> np.ndarray:
        """Modal phase collinearity (m,) of the shapes: 1 if all entries move in phase or against it.

        It is the MAC of a shape and its conjugate: with the products S of real and imaginary parts,
        ((S_xx - S_yy)^2 + 4 S_xy^2) / (S_xx + S_yy)^2.
        """
        self._demand_shapes()
        return np.diag(agreement(self.shapes, self.shapes.conj()))

    def real(self) -> "ModalData":
        """Return the modes with real shapes, each turned by the phase that leaves the least imaginary part.

        Of the two senses it has the one with the largest entry positive. Real shapes stay as they are.
        """
        if not self.is_complex:
            return self
        return replace(self, shapes=np.array([real_shape(shape) for shape in self.shapes]))

    def select(
        self, modes: Sequence[int] | None = None, channels: Sequence[str] | None = None
    ) -> "ModalData":
        """Some of the modes, and some of the channels.

        Parameters
        ----------
        modes : sequence of int, optional
            By index from 0, in the order they shall have; all by default.
        channels : sequence of str, optional
            By name, in the order they shall have; all by default.

        Raises
        ------
        ValueError, TypeError
            If there is no such mode or channel.
        """
        wanted, last = range(len(self)) if modes is None else modes, len(self) - 1
        rows = [check_integer(mode, "modes", least=0, most=last) for mode in wanted]
        columns = list(range(len(self.channels)))
        if channels is not None:
            self._demand_shapes()
            columns = find_channels(channels, self.channels, "these modes")
        arrays = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        chosen = {name: a[rows] for name, a in arrays.items() if isinstance(a, np.ndarray)}
        of_channels = {name: chosen[name][:, columns] for name in ("shapes", "shape_sd") if name in chosen}
        return replace(self, channels=[self.channels[index] for index in columns], **chosen | of_channels)

    def modal_masses(self) -> np.ndarray:
        """Modal masses (m, r) [kg] of the shapes as they are scaled, from forces at a channel of their name.

        Of a structure that a force shakes where a channel measures in its direction: the shape there over the
        participation. NaN for other inputs. ValueError without a participation, or without shapes.
        """
        what = "`modal_masses` needs a `participation`. Identify modes with their excitation."
        require(self.participation is not None, what)
        self._demand_shapes()
        at = [self.channels.index(name) if name in self.channels else -1 for name in self.inputs]
        there = np.where(np.array(at) < 0, np.nan, self.shapes.real[:, at])
        return there / self.participation

    def _demand_shapes(self):
        what = "`shapes` must be there for this, got frequencies alone. Read them as well."
        require(self.shapes is not None, what)


def refusal(what: str, got, advice: str = "") -> ValueError:
    """The error that says what must be, what there is instead, and what to do."""
    return ValueError(f"{what}, got {got}.{' ' if advice else ''}{advice}")


def demand(holds, what: str, got, advice: str = "") -> None:
    """Refuse what does not hold."""
    if not holds:
        raise refusal(what, got, advice)


def check_numbers(value, name: str, *sizes: int) -> np.ndarray:
    """Numbers beside frequencies, by their name; `sizes` are those of the axes of `AXES`."""
    values, (axes, least, below, condition, advice) = as_numbers(value, name), _NUMBERS[name]
    shape = tuple(sizes[AXES.index(axis)] for axis in axes.rstrip(",").split(", "))
    what = f"`{name}` must have shape ({axes}) = {shape}"
    demand(
        values.shape == shape, what, values.shape, f"Pass one for each {axes.split(', ')[-1].rstrip(',')}."
    )
    wrong = values[~((values >= least) & (values < below) | np.isnan(values))]
    require(not wrong.size, f"`{name}` must be {condition}, got {[*wrong, None][0]}{advice}")
    return values


def without_nan(values: np.ndarray) -> np.ndarray:
    """Values with zero for NaN; of complex numbers where one of the parts is NaN."""
    return np.where(np.isnan(values), 0.0, values)


def _names(value, name: str, what: str) -> list[str]:
    """Texts, and numbers as texts."""
    given = as_list(value)
    if given is None or not all(isinstance(label, str) or is_number(label) for label in given):
        raise TypeError(message(name, what, shown(value)))
    return [label if isinstance(label, str) else check_title(label) for label in given]


def find_channels(wanted: Sequence[str], names: Sequence[str], where: str) -> list[int]:
    """Places of channels by their names."""
    if isinstance(wanted, str) or not isinstance(wanted, Sequence | np.ndarray) or len(wanted) == 0:
        raise TypeError(f"`channels` must be a sequence of at least one name, got {wanted!r}.")
    places = {name: index for index, name in enumerate(names)}
    unknown = [*(name for name in wanted if name not in places), None]
    what = f"`channels` must be among those of {where} ({listed(names)})"
    demand(len(unknown) == 1, what, repr(unknown[0]), "Pass one of these names.")
    return [places[name] for name in wanted]


def mac(shapes: ArrayLike, others: ArrayLike) -> np.ndarray:
    r"""Modal assurance criterion of each pair of shapes.

    .. math:: \mathrm{MAC} = \frac{|\phi^H \hat\phi|^2}{(\phi^H \phi)(\hat\phi^H \hat\phi)}

    One where the shapes are the same up to a factor, real or complex; zero where they are orthogonal. With
    the best factor a, ``1 - MAC = ||a phi - phi^||^2 / ||phi^||^2``.

    Parameters
    ----------
    shapes, others : array_like (m, s), (i, s)
        One shape in each row; entries that are NaN in either are left out of the pair.

    Returns
    -------
    array (m, i)
        NaN where a pair has no entry in common.

    References
    ----------
    R. J. Allemang & D. L. Brown, Proc. 1st Int. Modal Analysis Conf. (1982) 110-116.

    Examples
    --------
    >>> mac([[1.0, 2.0], [2.0, -1.0]], [[-2.0, -4.0]])
    array([[1.],
           [0.]])
    """
    shapes = as_numbers(shapes, "shapes", "Give one shape in each row.", allow_complex=True)
    others = as_numbers(others, "others", "Give one shape in each row.", allow_complex=True)
    alike = shapes.ndim == others.ndim == 2 and shapes.shape[1] == others.shape[1]
    what, got = "`shapes` and `others` must have rows of equal length", f"{shapes.shape} and {others.shape}"
    demand(alike, what, f"shapes {got}", "Give one shape in each row, at the same channels.")
    one, two = ~np.isnan(shapes), ~np.isnan(others)
    a, b = (np.where(known, x, 0.0) for known, x in ((one, shapes), (two, others)))
    # squares of tiny or huge entries would leave the range of numbers
    a, b = (x / np.maximum(abs(x).max(axis=1, keepdims=True, initial=0.0), 1e-300) for x in (a, b))
    products = abs(a.conj() @ b.T) ** 2
    norms = (abs(a) ** 2 @ two.T) * (one @ (abs(b) ** 2).T)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(norms > 0.0, products / norms, np.nan)


def agreement(shapes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Modal assurance criterion (m, i), at most 1; 0 where shapes have no entry in common."""
    return np.minimum(np.nan_to_num(mac(shapes, others)), 1.0).round(15)


def real_shape(shape: np.ndarray) -> np.ndarray:
    """Real part of a shape (s,), turned by the phase that leaves the least imaginary part.

    That is half the phase of phi^T phi; of the two senses, the one with the largest entry positive.
    """
    unit = shape / np.nanmax(np.abs(shape))
    turned = (shape * np.exp(-0.5j * np.angle(np.nansum(unit * unit)))).real
    turned[np.isnan(shape)] = np.nan
    return turned if turned[np.nanargmax(np.abs(turned))] > 0.0 else -turned


warn_modes = partial(warn_caller, category=ModalDataWarning)
