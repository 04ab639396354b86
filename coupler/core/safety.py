"""Safety factors of all explicit time steps: which share of its stability limit each step takes, and why.

Central differences are stable up to 2 / omega of the highest frequency omega, explicit conduction up to 2 / (fastest rate). Where a
limit is found by power iteration the safe bound of single cells or elements is known too: the step is never shorter than what that
allows, and at most LONGEST times as long, whatever the iteration finds.
"""

# Points by their highest frequency (`particle.frequency`): the iteration is right to 2 %; the rest is for stress, viscosity and the
# springs of the contact, which it leaves out (docs/theory/particle.md).
POINTS = 0.85
# Points of the schemes with hourglass control: c dt over the spacing, and over the smallest principal stretch of a point; 0.5 to 0.98
# of the true limit (docs/theory/particle.md).
COURANT, STRETCH = 0.4, 0.9
# Elements by their own bound, which bounds the whole mesh (`fe.kernels.stable_dt`): for what they stiffen while a step is kept.
ELEMENTS = 0.85
# The mesh by its highest frequency (`fe.stability`): a mode that becomes the fastest within ten steps is found too late.
MESH = 0.85
LONGEST = 3.0
# Bonds between particle and target (`contact.particle_bonds`): row sums of their stiffness are a bound, masses and ends do not change.
BONDS = 0.9
# Springs of the contact: a point bears one to a second body too, where its mass is at least 0.78 of the lightest node's.
CONTACT = 0.8
# Bodies that move on after they have been brought to equilibrium (`target.equilibrium`): the step is kept between two searches.
SETTLED = 0.9
# Conduction among points and among elements: Gershgorin bounds the fastest rate, conductivities change within the step.
CONDUCTION = 0.9
