"""Targets with known answers: one target, one file. `TARGETS` maps a name to `function(d) -> Problem`."""

from functools import partial

from benchmarks.known.targets import (
    banana,
    corner,
    eight_schools,
    funnel,
    gaussian,
    logistic,
    ridge,
    separated,
    student,
)

TARGETS = {
    "gaussian": gaussian.build,
    "funnel": funnel.build,
    "banana": banana.build,
    "modes_37": partial(separated.build, weights=(0.3, 0.7)),
    "modes_19": partial(separated.build, weights=(0.1, 0.9)),
    "modes_1234": partial(separated.build, weights=(0.1, 0.2, 0.3, 0.4)),
    "student": student.build,
    "corner": corner.build,
    "ridge": ridge.build,
    "schools": eight_schools.build,
    "schools_centred": partial(eight_schools.build, centred=True),
    "logistic": logistic.build,
}

# the problems of the tables, as NAME-d
NAMES = (
    *("gaussian-10", "gaussian-30", "gaussian-100", "funnel-10", "banana-10"),
    *("modes_37-2", "modes_19-2", "modes_1234-2", "modes_37-10", "modes_19-10", "modes_1234-10"),
    *("student-10", "corner-2", "corner-10", "ridge-2", "schools-10", "schools_centred-10", "logistic-10"),
)
