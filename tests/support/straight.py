"""Records that are straight lines between their samples, for tests beside routes that join samples so."""

from functools import partial

from pymc_features import records

Record = partial(records.Record, interpolation="linear")
Loading = partial(records.Loading, interpolation="linear")
