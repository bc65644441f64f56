"""Every number of the belief that was chosen, each with its unit, its meaning and what it was found on.

`./pushfric study --constants` halves and doubles each: no other value says clearly more of simulated pushes and of both
halves of the public ones.
"""

NU = 4.0
"""Degrees of freedom of the Student distribution of a stretch: usual for robust regression (Lange, Little and Taylor, 1989)."""

SMOOTH, ORDER = 1.0, 3
"""Standard deviation of the log pressure's lowest cosines over the support, those of higher order the less; and their highest
order."""

WHITES = (0.7, 2.0)
"""Standard deviations of each support point's own log pressure: an area, or feet. The one chosen
foretells each sector of the contacts better from the others."""

MU_C, MU_C_SPREAD = 0.3, 0.6
"""Median of mu_c before any push, and standard deviation of its logarithm: 90 of 100 pairs of materials lie in .11 to .8."""

VARIES = 0.1
"""Standard deviation of the logarithm of mu_c from push to push: no contact is the same as the last. Without it, a single push
that just begins to slide would fix mu_c."""

REACH = 0.55
"""A support nearer to the centre of rotation than this share of the rms arm pushes partly in an unknown direction, as in the
program."""

ROUNDED = 0.03
"""Slopes see the corner of Coulomb's law rounded by this share of the rms arm times the turn."""

LEAST_SCALE = 5e-3
"""Least scale of the errors, as a share of the median length of a stretch: a fit of few stretches may be exact by chance. No
pushes of docs/public_data.md are below .0087; with .001, the demo's object seemed to change in 5 of 24 runs."""

FORCE_SPREAD = 0.15
"""Standard deviation of the logarithm of a measured ratio of shear to normal force while the tip slides."""

SURELY_SLID = 0.2
"""A tip slid if its slip exceeds this share of its way."""

LEAST_RATIO = 0.01
"""No friction is smaller than this."""

OPEN = 2.0
"""mu_c is only bounded if the largest on the grid is at most e to this times less likely than the likeliest."""

LONGEST_STRETCH = 0.5
"""A push is cut into stretches about this long, as a share of the support's size."""

USUAL_WAY = 0.1
"""Median way of observations whose unit of time is not known, as a share of the support's size."""

MOST_STRETCHES = 250
"""... of which at most so many are used: friction's misfit is shared by pushes alike, so that more of them hardly help. With
150, strokes of the steel plates of docs/public_data.md that were not fitted are foretold worse by one part in a hundred."""

SECTORS = 8
"""Groups of contacts by bearing, whose errors are taken for independent of each other's."""

WIDER = 3.0
"""Factor on the variance between sectors, which are few. It was chosen on two of the five steel plates of docs/public_data.md
(hexagon and rect3), after ten and twenty strokes. Half of it would do for the triangle, and for simulated friction, which has
no misfit of its own."""

FLOOR = 0.001
"""Standard deviation of p_CF that no number of pushes takes away, as a share of the support's size: outline and camera."""

COMMON = 0.9
"""... and as a share of the rms arm times the scale of the errors per length: friction's departure from its model that all
pushes have in common. It was chosen on the triangle and the steel plates of docs/public_data.md, with the tables in view."""

PAIRS = 16
"""Half the number of samples; each has its mirror image about the mean."""

FEWEST_COMPARED = 6
"""With fewer pushes, none is said to be bad, the object the same, and no mistake is looked for."""

BAD_PUSH = 0.05
"""Probability, before any push, that one is bad."""

BROAD = 0.25
"""Scale of the errors of a bad push, as a share of its way; their distribution is Cauchy's."""

MANY_BAD = 0.34
"""If more than this share of the pushes seem bad, the belief is."""

CHANGED, SHIFT = 0.01, 0.05
"""Probability, before any push, that the object changed before one of the last pushes, and standard deviation of the shift of
p_CF along each axis then, as a share of the support's size. Chosen on simulated runs, with the sets of docs/public_data.md in
view: with .02 and .1, shifts of 4 mm were found in 50 of 100 runs, not 63, and more of these sets seemed to change."""

LATEST, FEWEST_AFTER, FEWEST_BEFORE = 6, 3, 10
"""A change is looked for before the last LATEST to FEWEST_AFTER pushes, if FEWEST_BEFORE say what the object was. With 2 and 5,
as it was, an object that stays the same seemed to change after some push in 7 of 100 simulated runs, and in 20 on the steel
plates of docs/public_data.md, with which in view the last two were chosen."""

MISTAKE, GEOMETRY = 0.01, 0.02
"""Probabilities, before any push, of a mistake in units, signs or columns; and that contacts or the motion's frame are off."""

MOST_COMPARED = 60
"""Mistakes are compared by so many stretches at most, over so many support points."""

CLEAR = 0.05
"""Where motions are off by no more than this angle [rad], units, signs and columns are right."""

REACH_OFF = 0.03
"""Standard deviation of how far contacts or the motion's frame are off, along each axis, if they are [m]."""

SMALL_SUPPORT = 0.75
"""Support points that span less than this share of the contacts leave a part of the object out."""
