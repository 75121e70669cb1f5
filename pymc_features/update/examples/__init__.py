"""Examples of a configuration: each a file here, a template in `templates`, and a line in `EXAMPLES`.

The file has a function that takes the name of the file for simulated channels, and whether they must be
simulated, and returns an `Example`.
"""

from pymc_features.update.examples.building import building
from pymc_features.update.examples.shaking_table import shaking_table

EXAMPLES = {"shaking-table": shaking_table, "building": building}
