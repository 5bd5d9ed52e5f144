"""Every threshold of a decision that a diagnosis makes, with its reason and the data on which it was set.

Evidence is twice a log likelihood ratio less the price of the further unknowns (ΔBIC); on held-out data, where nothing
was fitted, nothing has a price. Its thresholds are Kass and Raftery's (1995). The shares are empirical: they were set
on the simulated development joints of the battery (seeds 703, 811 and 929), whose effects have other forms than the
catalogue's laws. All of them hold for valve-driven and for angle-driven joints alike: on the measured sealed joint the
two effects have evidence of 13 and 11 and remove 0.79 each of the held-out excess. Only the measure of the excess
differs (:meth:`~pam_antagonist.inference.angle_driven.AngleDriven.excess_removed` says why). Numerical tolerances of an
algorithm stand in its own module. Thresholds of many short episodes stand in
:mod:`pam_antagonist.inference.episode_search`: identification has them as well.
"""

from __future__ import annotations

from pam_antagonist.inference import starts

# Evidence.

POSITIVE = 2.0
"""Evidence that Kass and Raftery (1995) call positive, more than a bare mention."""
STRONG = 6.0
"""Evidence that Kass and Raftery (1995) call strong."""
TAKEN = 2.0 * STRONG
"""Evidence of the fitted and the held-out part together for an effect with strong held-out evidence. A slow effect
shows few times in each part, and its parameters have a price in the fitted part only."""
TAKEN_WITHOUT_STRONG_HELD_OUT = 4.0 * STRONG
"""Likewise where the held-out evidence is only positive: something else that the model lacks hides it there."""
LEAST_SCORE = 2.0
"""Score (evidence to first order) below which a candidate is not fitted."""
MOST_EFFECTS = 3
"""An explanation by more effects than this would explain anything."""
LEAST_PARAMETERS = 2
"""Free parameters that a perfect explanation would need at least; their price decides whether anything is wrong."""

SPLITS_AGREE = 3
"""Splits of five that support an effect at least: the majority. An effect that is not there loses likelihood where
nothing was fitted, in each split anew."""

# Excess over noise.

AT_NOISE = starts.AT_NOISE
"""Multiples of the noise below which a residual is noise: 60 s give the noise to a few per cent."""

STRETCHES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""[s] Lengths of the stretches that are tested for more than noise, each in steps of half its length, and the whole. A
stretch keeps the verdict from being `none` if its evidence against noise is strong (:data:`STRONG`) with the price of
all stretches paid. The noise may be larger than it was estimated by :data:`AT_NOISE`. Set on 16 simulated joints with
nothing wrong, of 60 s, free and locked: the evidence before its price of about 14 was 7.7 at most."""

FIRST_SHARE = 0.05
"""Share of the held-out excess that the first effect removes at least. It may be small where another effect is there
too. A law that holds removes some of it on data that no fit has seen."""
FURTHER_SHARE = 0.12
"""Share of the whole excess, fitted and held out together, that a further effect removes at least. Most of what the
first effect leaves may be due to its form. On the development joints, effects that were not there removed 0.09 at
most, real second effects 0.15 at least."""
EXPLAINED = 0.4
"""Share of the whole excess that the effects together remove at least, to be called the explanation. The held-out part
alone would let one event decide. On the development joints, one right effect in another form removed 0.5 or more (Hess
and Soom's friction 0.10 to 0.12), two of them 0.6; effects that imitated what is in no catalogue 0.26, two 0.35."""
EXPLAINED_BY_LEADER = 0.2
"""Share of either part's excess, fitted and held out, from which one effect alone is named in part, where all others
are far behind it. An effect in another form than the catalogue's law may leave most of the excess in decibels."""
LEADS = 2.0
"""Evidence of such an effect over that of the next best one. What is in no catalogue is imitated by several effects
about as well. Both were set with the 24 unexplained cases of even numbers of battery 2203 in view: three effects that
were there had shares of 0.22, 0.33 and 0.36 and 2.2 to 6 times the evidence; imitators less, or 1.2 times at most."""
EXPLAINED_WELL = 0.6
"""Below it a warning says that something is left: another form of the effect, or something smaller."""

SHARE_OF_CHANNEL = 0.1
"""Share of the error over noise that a learned law takes off at least, on held-out data, in the channel where it takes
most. In decibels a law may remove enough where the error is small, and leave the error as it is: two such laws, which
took 2 and 5 %, told their users nothing and stood in their rig files."""

# Calibrations.

CERTAIN_CALIBRATION = 5.0
"""Standard deviations from 0 of a calibration that is reported. Beside a model that is at the noise without it, every
block of samples counts for it, and not one error a second. One joint was in view (a late pressure at 4.97)."""

# Sizes of effects, and agreement between recordings.

SMALL_SIBLING = 0.1
"""A muscle whose size is smaller than this share of the other muscle's is not named."""
CERTAIN_SIZE = 2.0
"""Standard deviations from 0 of a size that is reported."""
SIZES_DIFFER = 0.25
"""Relative difference above which sizes in two recordings are reported as a contradiction."""
SIZES_DIFFER_STD = 3.0
"""Least size of that difference, in its standard deviations."""
OTHER_RIG_PRIORS = 5.0
"""Standard deviations of the prior: base parameters of one rig do not differ by so much between recordings."""
OTHER_RIG_STD = 5.0
"""Least size of that difference, in standard deviations of the fits."""
OUT_OF_PRIORS = 2.0 * OTHER_RIG_PRIORS
"""Standard deviations of its prior beyond which a fitted value says nothing of the rig: twice what two rigs differ."""
IMPLAUSIBLE = 5.0
"""Standard deviations of its prior that a base parameter moves before a warning says so."""
ESTIMATOR_WORSE = 1.5
"""Growth of an estimator's error that is not chance."""

MARGIN = 1.05
"""Errors on held-out data with a smaller ratio count as equal, as in a replay's findings."""

# Disturbance torques.

DISTURBANCE_STANDS_OUT = 3.0
"""An episode's torque is so many times the median torque."""
MOST_ACTIVE = 0.5
"""Share of the time. A torque that acts longer does not come and go."""
LEAST_EPISODES = 2
"""A single event may have any cause."""
DISTURBANCE_SQUARES = 0.75
"""Share of the squares over noise, fitted and held out together, that goes with the torque. Disturbances are events,
and events have most of the squares."""
DISTURBANCE_EXCESS = 0.2
"""Share of the excess in decibels that goes likewise. Events in what a law of another form leaves carry little of it:
0.10 on a development joint with hysteresis, where 0.82 of the squares were gone."""
RECURRING = 0.5
"""Share of the torque's square that the torque at the same angle at other times predicts. Above it, the torque is a law
of the angle. Cogging has 0.8 and more, disturbances less than 0.3."""
DISTURBANCE_BESIDE = 2.0 * STRONG
"""Evidence for a disturbance beside effects that explain the recordings already: what an effect of another form leaves
may come and go as well."""
PARAMETERS_OF_EPISODE = 3
"""Begin, end and height: the price of each episode."""
CLEAN = 2.0
"""Multiples of the noise above which a recording has something that a disturbance would have to explain."""

# Recordings.

SHORTEST = 20.0
"""[s] What drifts for seconds must come several times into the fitted part, and into the rest."""
SHORTEST_DRIVEN = 10.0
"""[s] Likewise where the angle is the input: both parts need a stretch of sliding and one of sticking. Shorter than
:data:`SHORTEST`, since such a model carries no error along."""
HOLDOUT = (0.1, 0.5)
"""Shares of a recording that may be held out."""
FEW_SWEEPS = 4
"""All samples of a sweep have nearly the same error. With fewer sweeps a warning says so."""

HOLDS = 0.9
"""Share of held-out measurements in a filter's 95 % interval below which a report says that it is too narrow."""

# What is left.

CLEAR_EQUATION_ERROR = 1.3
"""Multiples of the sensors' noise from which an equation's error is described: its noise is known less well."""
LEAST_DEPENDENCE = 0.05
"""Share of a residual's variance from which a dependence or a form is named."""
CHANCE = 0.05
"""Probability below which a correlation is not called chance."""
