"""`python -m pymc_features`: the command where its name is not found."""

import sys

from pymc_features.cli import command

if __name__ == "__main__":
    sys.exit(command())
