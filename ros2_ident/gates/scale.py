# SPDX-License-Identifier: Apache-2.0
"""Numbers that several judgements share, so that one idea has one value.

Where nothing else is said they are set by hand.
"""

# Samples below which nothing is said: a standard deviation of so many is known to 7 %.
FEWEST = 100
# Means over so long, s, keep what is slow: the motion changes little meanwhile.
STEP = 0.005
# Efforts are compared with motion up to this frequency, Hz.
SLOW = 10.0
# Periods of a band's end that are left out at either end of a log, where a filter knows nothing of
# what came before.
ENDS = 1.5
# Shares of one signal that another explains, from which on it follows and below which it does not.
FOLLOWS, STRAYS = 0.9, 0.3
# Most of something, as a share.
MOSTLY = 0.8
# A factor on a noise, a limit or a unit that is more than inexact, and one that no force or tuning
# makes: another unit, or another drive's.
MORE, ANOTHER = 1.2, 3.0
# Noise that is stated and noise that is found may differ by this factor.
OTHER_NOISE = 1.5
# So many times the noise is no noise.
FLOORS = 20.0
# A value stands out of others by so many of their standard deviations: of 90,000 normal ones one
# in twenty logs has one that does.
STANDS_OUT = 5.0
# Stamps of topics may lie so far apart, s; efforts and positions that are later than this, s, are
# late, and efforts later than the last are no matter of a log.
APART, LATE, LATEST_EFFORT = 0.5, 3e-3, 0.12
# What explains so much of a drive's signal is the drive's own; names are swapped where that leaves
# this share of what is left without.
OWN, SWAPPED = 0.98, 0.2
# How many of these are one rad or one m.
UNITS = {'rad': ((57.29578, 'degrees'), (0.1591549, 'turns')), 'm': ((1000.0, 'mm'),)}


def near(ratio: float, factor: float = MORE) -> bool:
    """Return whether a ratio is 1 but for less than a factor."""
    return 1.0 / factor < ratio < factor


def figure(value: float, sign: str = '') -> str:
    """Return a number with two digits that tell, as an engineer writes it: 280, not 2.8e+02."""
    return f'{float(f"{value:.2g}"):{sign}g}'
