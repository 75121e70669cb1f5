"""The directive `gallery`: pictures of the package and of arviz-plots, each with the code that draws it.

They are drawn when the pages are built as HTML, from one model, a shared `Example`; the build with `dummy`
lists code and captions alone. `python docs/gallery.py FOLDER` writes the pictures to a folder.
"""

import inspect
import sys
import textwrap
import warnings
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path

import numpy as np

PLACE = "_static/gallery"  # below the built pages
PICTURES = {}  # name: function of an `Example`, with a caption as docstring


def picture(function):
    """Enter a function among the pictures."""
    PICTURES[function.__name__] = function
    return function


class Example:
    """Three storeys, measured on all floors under a synthetic earthquake, and what pictures share of them."""

    def __init__(self):
        import pymc_features as pmf

        self.record = pmf.synthetic_earthquake(10.0, 0.02, random_seed=1, pga=3.0)
        floors = pmf.simulate(self.structure(0.9, 1.1), self.record)
        noise = np.random.default_rng(2).standard_normal(floors.shape)
        self.measured = floors + 0.5 * float(floors.std()) * noise

    def structure(self, lower, upper):
        """A chain with factors on its lowest spring and on the two others."""
        import pymc_features as pmf

        chain = pmf.SpringMassChain(mass=np.ones(3), stiffness=600.0, damping=pmf.ModalDamping(0.03))
        return chain.scale_stiffness(lower, springs=[0]).scale_stiffness(upper, springs=[1, 2])

    @cached_property
    def model(self):
        import pymc as pm

        import pymc_features as pmf

        with pm.Model(coords={"sensor": [0, 1, 2]}) as model:
            lower = pm.LogNormal("lower", 0.0, 0.3)
            upper = pm.LogNormal("upper", 0.0, 0.3)
            sigma = pm.HalfNormal("sigma", 1.0)
            mu = pmf.response(self.structure(lower, upper), self.record)
            pm.Normal("y", mu, sigma, observed=self.measured.values)
        return model

    @cached_property
    def idata(self):
        import pymc as pm

        import pymc_features as pmf

        with self.model:
            idata = pmf.sample_smc(400, chains=4, cores=1, random_seed=1, progressbar=False)
            prior = pm.sample_prior_predictive(400, var_names=["lower", "upper", "sigma"], random_seed=1)
            idata["prior"] = prior["prior"]
        return idata

    @cached_property
    def channels(self):
        """The motion of the base and of the floors, as `read_channels` returns them."""
        import xarray as xr

        values = np.vstack([self.record.acceleration, self.measured.values])
        coords = {"sensor": ["base", "first", "second", "roof"], "time": self.record.time}
        return xr.DataArray(values, coords, ("sensor", "time"), attrs={"units": "m/s^2"})

    @cached_property
    def identified(self):
        """Modes as a test may have left them."""
        import pymc_features as pmf

        modes = self.structure(0.9, 1.1).modes()
        noise = 0.05 * np.random.default_rng(3).standard_normal((3, 3))
        shapes = (modes.mode_shapes / abs(modes.mode_shapes).max(axis=0)).T
        return pmf.modal.ModalData(modes.natural_frequencies, shapes + noise, ["first", "second", "roof"])

    @cached_property
    def windy(self):
        """Accelerations of the floors in ten minutes of wind."""
        import pymc_features as pmf

        gusts = pmf.Loading(np.random.default_rng(4).standard_normal((3, 15_000)), 0.04, kind="force")
        matrices = self.structure(0.9, 1.1).matrices()._asdict()
        return pmf.simulate(pmf.LinearStructure(**matrices), gusts)


@picture
def record(example):
    """The motion of the base"""
    import pymc_features as pmf

    pmf.plots.record(example.record)


@picture
def channels(example):
    """All channels on one scale"""
    import pymc_features as pmf

    pmf.plots.channels(example.channels)


@picture
def prior_posterior(example):
    """What the data have changed"""
    import pymc_features as pmf

    pmf.plots.prior_posterior(example.idata, ["lower", "upper", "sigma"])


@picture
def ranks(example):
    """Do the chains agree? Ranks of their draws"""
    import pymc_features as pmf

    pmf.plots.chains(example.idata, "rank", ["lower", "upper"])


@picture
def traces(example):
    """The same as traces"""
    import pymc_features as pmf

    pmf.plots.chains(example.idata, "trace", ["lower", "upper"])


@picture
def tempering(example):
    """The way from the prior to the posterior"""
    import pymc_features as pmf

    pmf.plots.tempering(example.idata)


@picture
def response(example):
    """The response of the fitted model, and what was measured"""
    import pymc_features as pmf

    bands = pmf.prediction.posterior_response(
        example.idata, example.structure, example.record, draws=50, random_seed=1
    )
    pmf.plots.response(bands, "absolute_acceleration", sensors=[0, 2], measured=example.measured)


@picture
def drifts(example):
    """Drifts that no sensor has measured, under a stronger earthquake"""
    import pymc_features as pmf

    stronger = pmf.synthetic_earthquake(10.0, 0.02, random_seed=5, pga=6.0)
    quantity = "inter_storey_drift"
    bands = pmf.prediction.posterior_response(
        example.idata, example.structure, stronger, quantity, draws=50, random_seed=1
    )
    pmf.plots.response(bands, quantity)


@picture
def fragility(example):
    """The probability that a drift is exceeded, against the limit"""
    import matplotlib.pyplot as plt

    import pymc_features as pmf

    limits = np.linspace(0.01, 0.04, 121)
    found = pmf.prediction.first_passage_probability(
        example.idata, example.structure, example.record, limits, draws=100, random_seed=1
    )
    axes = plt.figure(layout="constrained").subplots()
    axes.plot(1e3 * limits, found["probability"].values, label=["first", "second", "third storey"])
    axes.set(xlabel="drift [mm]", ylabel="probability [-]")
    axes.legend()


@picture
def loops(example):
    """Force against drift of springs that yield"""
    import matplotlib.pyplot as plt

    import pymc_features as pmf

    chain = pmf.HystereticChain(
        mass=np.ones(3),
        stiffness=600.0,
        damping=pmf.ModalDamping(0.02),
        yield_displacement=0.02,
        post_yield_ratio=0.1,
    )
    forces = pmf.structures.spring_forces(chain, example.record)
    axes = plt.figure(layout="constrained").subplots()
    axes.plot(1e3 * forces["drift"].values.T, forces["force"].values.T, label=["first", "second", "third"])
    axes.set(xlabel="drift [mm]", ylabel="force [N]")
    axes.legend()


@picture
def mac(example):
    """Identified modes against those of the model"""
    import pymc_features as pmf

    pmf.plots.mac(example.identified, example.structure(1.0, 1.0).modes())


@picture
def mode_shapes(example):
    """Their shapes along the storeys"""
    import pymc_features as pmf

    pmf.plots.mode_shapes(example.identified, example.structure(1.0, 1.0).modes())


@picture
def singular_values(example):
    """Singular values of the spectra in the wind, with the bands that are proposed"""
    import pymc_features as pmf

    pmf.plots.singular_values(example.windy, pmf.ambient.propose_bands(example.windy))


@picture
def stabilisation(example):
    """Poles of subspace models of rising order, by pyOMA2"""
    import pymc_features as pmf

    pmf.plots.stabilisation(pmf.ambient.subspace_poles(example.windy, order=20))


@picture
def sensor_placement(example):
    """Where a second sensor tells most"""
    import pymc_features as pmf

    places = pmf.sensor_placement(example.model, None, 2, draws=2, random_seed=1)
    pmf.plots.sensor_placement(places)


@picture
def forest(example):
    """Intervals side by side (arviz-plots)"""
    import arviz_plots as azp

    azp.plot_forest(example.idata, var_names=["lower", "upper"], combined=True)


@picture
def densities(example):
    """Densities with their intervals (arviz-plots)"""
    import arviz_plots as azp

    azp.plot_dist(example.idata, var_names=["lower", "upper", "sigma"])


@picture
def pairs(example):
    """Which parameters go together (arviz-plots)"""
    import arviz_plots as azp

    azp.plot_pair(example.idata, var_names=["lower", "upper", "sigma"])


@picture
def ridges(example):
    """Chains above each other (arviz-plots)"""
    import arviz_plots as azp

    azp.plot_ridge(example.idata, var_names=["lower", "upper"])


@picture
def effective_draws(example):
    """Effective draws of each quantile (arviz-plots)"""
    import arviz_plots as azp

    azp.plot_ess(example.idata, var_names=["lower", "upper"])


@picture
def standard_errors(example):
    """Standard errors of quantiles (arviz-plots)"""
    import arviz_plots as azp

    azp.plot_mcse(example.idata, var_names=["lower", "upper"])


@picture
def autocorrelation(example):
    """Are the draws independent? (arviz-plots)"""
    import arviz_plots as azp

    azp.plot_autocorr(example.idata, var_names=["lower"])


@picture
def prior_and_posterior(example):
    """Densities of prior and posterior (arviz-plots)"""
    import arviz_plots as azp

    azp.plot_prior_posterior(example.idata, var_names=["lower", "upper"])


def is_possible(name: str) -> bool:
    """Whether the library that a picture needs is installed."""
    return name != "stabilisation" or find_spec("pyoma2") is not None


def draw(folder: Path, names=None) -> list[Path]:
    """Write the pictures, all by default, and return their files."""
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    example, files = Example(), []
    for name in names or filter(is_possible, PICTURES):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of few draws
            PICTURES[name](example)
        files.append(folder / f"{name}.png")
        plt.gcf().savefig(files[-1], dpi=80, bbox_inches="tight")
        plt.close("all")
    return files


def code_of(function) -> str:
    """The body of a function, without its docstring and the imports that all share."""
    lines = textwrap.dedent(inspect.getsource(function).partition('"""\n')[2]).splitlines()
    return "\n".join(line for line in lines if "import pymc_features" not in line).strip()


def entry(name: str) -> str:
    """Caption, picture and code in Markdown."""
    function = PICTURES[name]
    caption = function.__doc__.splitlines()[0]
    image = f'<img src="{PLACE}/{name}.png" alt="{caption}" loading="lazy" style="max-width: 100%">'
    return f"## {caption}\n\n{image}\n\n```python\n{code_of(function)}\n```\n"


def setup(app):
    """Called by Sphinx."""
    from sphinx.util.docutils import SphinxDirective

    class Gallery(SphinxDirective):
        """All pictures, each with its code."""

        def run(self):
            self.env.note_reread()
            text = "\n".join(entry(name) for name in PICTURES if is_possible(name))
            return self.parse_text_to_nodes(text, allow_section_headings=True)

    def draw_all(app, exception):
        if exception is None and app.builder.name == "html":
            draw(Path(app.outdir) / PLACE)

    app.add_directive("gallery", Gallery)
    app.connect("build-finished", draw_all)
    return {"parallel_read_safe": True}


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
