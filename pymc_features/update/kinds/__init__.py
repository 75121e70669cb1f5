"""Kinds of data: what a file may say of each, how it is read, declared, predicted and judged.

A new kind is a file here with a class that has the methods of `KindOfData`, and a line in `KINDS_OF_DATA`.
"""

from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.update.kinds.ambient import Ambient
from pymc_features.update.kinds.cyclic import Cyclic
from pymc_features.update.kinds.events import Events
from pymc_features.update.kinds.external import External
from pymc_features.update.kinds.modal import Modal
from pymc_features.update.kinds.response_functions import FrequencyResponses
from pymc_features.update.kinds.responses import Responses

#: In the order in which they stand in a problem: the first one decides what is sampled.
KINDS_OF_DATA = (FrequencyResponses, External, Cyclic, Ambient, Events, Responses, Modal)
#: All likelihoods by name. The place of one is part of its seed.
KINDS = LIKELIHOODS | {entry.name: entry for kind in reversed(KINDS_OF_DATA) for entry in kind.own}
