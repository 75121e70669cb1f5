"""Linear structures whose matrices are affine in parameters."""

import copy
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Self

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Variable
from scipy import sparse

from pymc_features._checks import as_list, as_numbers, check_texts, message
from pymc_features.structures.base import MATRICES, NUMBERS, Values, as_variables, unpacked, vector
from pymc_features.structures.damping import Damping
from pymc_features.structures.linear import DofNames, LinearStructure
from pymc_features.structures.matrices import UNITS, MatrixLike, as_matrix
from pymc_features.structures.terms import OpenSeesModel, Terms, assembled_terms, exported_terms


class AffineStructure(LinearStructure):
    """K(theta) = K_0 + sum_i theta_i K_i, and M and C likewise: new parameters without assembly.

    Parameters
    ----------
    mass, stiffness, damping, influence
        M_0, K_0 and C_0 (or a `Damping`), as in `LinearStructure`; all but the first by name.
    stiffness_terms, mass_terms, damping_terms : sequence of p matrices or None, optional
        K_i, M_i and C_i, symmetric (C_i: any); None where parameter i does not act. The same theta_i
        multiplies all three. `damping_terms` need a damping matrix.
    theta : array_like (p,), optional
        Parameters [-], zeros by default.

    Examples
    --------
    Two storeys of 100 N/m, the upper one uncertain:

    >>> from pymc_features import RayleighDamping
    >>> lower, upper = np.diag([100.0, 0.0]), 100.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    >>> damping = RayleighDamping(0.1, 0.0)
    >>> frame = AffineStructure(
    ...     [1.0, 1.0], stiffness=lower, damping=damping, stiffness_terms=[upper], theta=[1.0]
    ... )
    >>> frame.with_parameters([0.5]).stiffness
    array([[150., -50.],
           [-50.,  50.]])
    """

    parameter_names: tuple[str, ...] | None = None
    inputs = LinearStructure.inputs | {
        "theta": vector("-")._replace(required=True),
        "stiffness_terms": MATRICES,
        "mass_terms": MATRICES,
        "damping_terms": MATRICES,
    }

    def __init__(
        self,
        mass: MatrixLike,
        *,
        stiffness: MatrixLike,
        damping: Damping | MatrixLike,
        stiffness_terms: Sequence[MatrixLike | None] = (),
        mass_terms: Sequence[MatrixLike | None] = (),
        damping_terms: Sequence[MatrixLike | None] = (),
        influence: MatrixLike | None = None,
        theta: Values | None = None,
    ):
        stiffness = as_matrix(stiffness, "stiffness", "N/m")
        terms_of = {"mass": mass_terms, "damping": damping_terms, "stiffness": stiffness_terms}
        terms_of = {kind: _listed(terms, f"{kind}_terms") for kind, terms in terms_of.items()}
        lengths = {len(terms) for terms in terms_of.values()} - {0}
        if len(lengths) != 1:
            listed = ", ".join(f"{len(terms)} {kind}_terms" for kind, terms in terms_of.items())
            raise ValueError(
                "`stiffness_terms`, `mass_terms` and `damping_terms` must have one entry for each parameter, "
                f"got {listed}. Pass None where a parameter does not act."
            )
        self.n_parameters = lengths.pop()
        terms = tuple(
            tuple(_term(a, kind, i, stiffness) for i, a in enumerate(matrices)) or (None,) * self.n_parameters
            for kind, matrices in terms_of.items()
        )
        self._install_constants((mass, stiffness, damping), influence, terms)
        if terms_of["damping"] and self._terms[1] is None:
            raise TypeError(
                f"`damping` must be a matrix to go with `damping_terms`, got {type(damping).__name__}. "
                "Pass C_0, which may be zero."
            )
        self._install(self._as_theta(np.zeros(self.n_parameters) if theta is None else theta))

    @classmethod
    def from_matrices(
        cls,
        build: Callable[..., tuple],
        parameters: Mapping[str, float],
        *,
        damping: Damping | MatrixLike | None = None,
        influence: MatrixLike | None = None,
    ) -> Self:
        """The structure of a function that assembles (M, C, K), or (M, K), from parameters.

        Parameters
        ----------
        build : callable
            Called with the parameters by name; returns matrices in kg, N s/m and N/m, arrays or sparse.
        parameters : mapping of str to float
            Names and nominal values, in the order of theta.
        damping, influence
            As of `LinearStructure`. Without `damping` C is that of `build`.

        Returns
        -------
        AffineStructure
            With theta at the nominal values. `with_parameters` takes them in this order, or by name.

        Raises
        ------
        ValueError, TypeError
            If the matrices are not affine in the parameters, which is named; if one changes nothing.

        Notes
        -----
        A_i = (A(theta + theta_i e_i) - A(theta)) / theta_i: each parameter is doubled once. The sum is
        compared with `build` at a point where all of them differ by up to 50 %, to 1e-9 of each entry.

        Examples
        --------
        >>> def column(EI, mass):  # of 2 m, a mass on its top
        ...     return [[mass]], [[3.0 * EI / 2.0**3]]
        >>> from pymc_features import ModalDamping
        >>> cantilever = AffineStructure.from_matrices(
        ...     column, {"EI": 1e6, "mass": 500.0}, damping=ModalDamping(0.02))
        >>> cantilever.with_parameters({"mass": 1000.0, "EI": 2e6}).stiffness
        array([[750000.]])
        """
        return cls._of_terms(assembled_terms(build, parameters, damping is None), damping, influence)

    @classmethod
    def _of_terms(cls, affine: Terms, damping, influence=None) -> Self:
        """The structure of terms that have a name, a nominal value and a matrix or more each."""
        if damping is None and "damping" not in affine.constants:
            raise ValueError(
                "`damping` must be given if `build` returns (M, K), got None. Pass ModalDamping(ratios), "
                "RayleighDamping(alpha, beta) or C in N s/m."
            )
        structure = cls(
            affine.constants["mass"],
            stiffness=affine.constants["stiffness"],
            damping=affine.constants["damping"] if damping is None else damping,
            stiffness_terms=affine.terms["stiffness"],
            mass_terms=affine.terms["mass"],
            damping_terms=affine.terms.get("damping", ()) if damping is None else (),
            influence=influence,
            theta=list(affine.nominal.values()),
        )
        structure.parameter_names = tuple(affine.nominal)
        return structure

    @classmethod
    def from_files(
        cls,
        base: str | PathLike | Mapping[str, str | PathLike | tuple],
        terms: Mapping[str, tuple | Sequence[tuple]],
        *,
        damping: Damping | MatrixLike | None = None,
        direction: str | Sequence[str] | None = None,
        units: str | None = None,
    ) -> Self:
        """The structure of exported matrices, of a base and with one property changed at a time.

        Parameters
        ----------
        base : path, or mapping of "mass", "stiffness" and, if wanted, "damping" to paths
            One file with all matrices, or one for each; (path, name) picks a matrix of several. Formats as of
            `read_matrices`. Names of degrees of freedom are those of the files.
        terms : mapping of str to (path, factor), or to a sequence of them
            For each parameter an export in which the property is `factor` times that of the base: stiffness,
            or a file with mass and stiffness, or (mapping as `base`, factor). A second export of another
            factor is compared with what the first one says.
        damping : Damping or array_like (n, n), optional
            In place of the damping matrix of the files.
        direction : "x", "y" or "z", or a sequence of them, optional
            Of the ground motion, by the names of the degrees of freedom; all move alike by default.
        units : str, optional
            Of force, length and mass in the files, such as "kN, m, t"; N, m and kg by default.

        Returns
        -------
        AffineStructure
            Its parameters are factors of the properties, 1 at the base, with these names. Degrees of freedom
            without stiffness and mass, and those that a program holds by a stiffness of 1e30 or more, are
            left out with a warning that names them.

        Raises
        ------
        ValueError, TypeError
            If a matrix is missing or of another size, or a second export shows that the matrices are not
            affine in a property.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> from pymc_features import ModalDamping
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     base, stiff = Path(folder) / "base.npz", Path(folder) / "stiff.npz"
        ...     np.savez(base, M=np.eye(2), K=np.array([[3.0, -1.0], [-1.0, 1.0]]))
        ...     np.savez(stiff, K=np.array([[4.0, -2.0], [-2.0, 2.0]]))
        ...     frame = AffineStructure.from_files(
        ...         base, {"upper": (stiff, 2.0)}, damping=ModalDamping(0.02))
        >>> frame.with_parameters({"upper": 0.5}).stiffness
        array([[ 2.5, -0.5],
               [-0.5,  0.5]])
        """
        exports = exported_terms(base, terms, units)
        structure = cls._of_terms(exports, damping)
        if exports.labels is None and direction is None:
            return structure
        return structure._shaken(direction, DofNames.of(exports.labels or ()))

    @classmethod
    def from_opensees(
        cls,
        build: Callable[..., object],
        parameters: Mapping[str, float],
        *,
        direction: str | Sequence[str] = "x",
        damping: Damping | MatrixLike | None = None,
    ) -> Self:
        """The structure of a model in OpenSees, read once for each parameter; OpenSees is not run again.

        Parameters
        ----------
        build : callable
            Called with the parameters by name; makes the model by commands of `openseespy.opensees`: nodes,
            masses, elements, constraints, if wanted `rayleigh` with constant coefficients. M, C and the
            tangent stiffness are taken as it leaves them. Models are wiped before and after.
        parameters : mapping of str to float
            Names and nominal values, in the order of theta.
        direction : "x", "y" or "z", or a sequence of them
            Of the ground motion. Several are several supports: pass a `Loading` with a row for each.
        damping : Damping or array_like (n, n), optional
            In place of the C of the model, which lacks what `modalDamping` adds.

        Returns
        -------
        AffineStructure
            Its degrees of freedom have names "node:direction", with x, y, z, rx, ry and rz. Those of nodes
            that follow others rigidly (`rigidDiaphragm`, `equalDOF`, `rigidLink`) can be sensors, too.

        Raises
        ------
        ImportError, ValueError, TypeError
            Without OpenSeesPy; as of `from_matrices`; if the model has no damping and none is given.

        Notes
        -----
        OpenSees gives full matrices: for up to some thousand degrees of freedom. Frequencies are those of
        `eigen` to 1e-6, histories those of its integration to 0.1 % (tests/structures/test_opensees.py).
        """
        model = OpenSeesModel(build)
        structure = cls.from_matrices(model, parameters, damping=damping)
        if damping is None and not structure._terms[1].stack.any():
            raise ValueError(
                "`damping` must be given if the model has none, got None. Pass ModalDamping(ratios) or "
                "RayleighDamping(alpha, beta), or call `rayleigh` in `build`."
            )
        return structure._shaken(direction, model.names)

    def _shaken(self, direction, names: DofNames):
        """The structure with names, in a ground motion of some directions."""
        if direction is not None:
            directions = check_texts(direction, "direction", "x, y, z or several of them")
            if not directions:
                raise ValueError(message("direction", "x, y, z or several of them", "none"))
            columns = [names.influence(one) for one in directions]
            self.influence = columns[0] if isinstance(direction, str) else np.stack(columns, axis=1)
        return self.with_dof_names(names)

    def _as_theta(self, theta):
        if isinstance(theta, Mapping):
            theta = self._in_order(theta)
        p, theta, advice = self.n_parameters, unpacked(theta), "Pass one for each parameter."
        vector = as_variables(theta, "theta", advice)
        if vector is not None:
            vector = pt.atleast_1d(vector)
            if vector.ndim == 1 and vector.type.shape[0] in (None, p):
                return vector
            got = f"a tensor of shape {vector.type.shape}"
            if not isinstance(theta, Variable):
                got = f"{len(theta)} values" if vector.ndim == 1 else "entries that are no scalars"
        else:
            vector = np.atleast_1d(as_numbers(theta, "theta", advice, what=NUMBERS))
            if vector.shape == (p,) and np.isfinite(vector).all():
                return vector
            got = f"shape {vector.shape}" if vector.shape != (p,) else "NaN or infinity"
        raise ValueError(f"`theta` must be {p} finite values, one for each parameter, got {got}.")

    def _in_order(self, theta):
        """Parameters that were given by name."""
        if self.parameter_names is None or set(theta) != set(self.parameter_names):
            names = ", ".join(self.parameter_names or ()) or "no names: pass a vector"
            got = ", ".join(map(str, theta)) or "none"
            raise ValueError(f"`theta` must have the parameters {names}, got {got}.")
        return [theta[name] for name in self.parameter_names]

    def with_parameters(self, theta: Values | Mapping[str, float | Variable]) -> Self:
        """Return the structure with other parameters; the constant matrices are shared.

        Parameters
        ----------
        theta : array_like (p,), TensorVariable (p,), sequence or mapping of p numbers and TensorVariables
            Parameters [-]; a mapping has them by name, after `from_matrices` or `from_opensees`. Numbers are
            checked: M(theta) and K(theta) must have no negative eigenvalue.
        """
        changed = copy.copy(self)
        changed._install(self._as_theta(theta))
        return changed


def _listed(terms, name):
    """A tuple of matrices; a single matrix would pass for its rows, each of them a diagonal."""
    listed = None if sparse.issparse(terms) or getattr(terms, "ndim", 3) != 3 else as_list(terms)
    if listed is None:
        raise TypeError(
            f"`{name}` must be a sequence of matrices, got {type(terms).__name__}. "
            "Pass a list, with None where a parameter does not act."
        )
    return tuple(listed)


def _term(matrix, kind, i, stiffness):
    """A term as the other matrices are: dense or sparse; None stays None."""
    if matrix is None:
        return None
    n, name = stiffness.shape[0], f"{kind}_terms[{i}]"
    matrix = as_matrix(matrix, name, UNITS[kind], n=n, symmetric=kind != "damping")
    return sparse.csc_array(matrix) if sparse.issparse(stiffness) else matrix
