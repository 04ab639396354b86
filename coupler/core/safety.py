"""Safety factors of all explicit time steps, with reasons. A factor is the time step divided by the stability limit.

Central differences are stable up to 2 / omega, where omega is the highest frequency; explicit conduction is stable up to 2 / (fastest
rate). A limit from power iteration is compared with the safe bound of single cells or elements: the step is between this bound and
LONGEST times this bound.
"""

# Points by their highest frequency (`particle.frequency`): the iteration finds the limit to 2 % in most steps; at worst it is 5 % too
# long (nickel at 500 m/s, copper at 900 m/s). The rest of the margin is for stress, viscosity and contact springs, which the iteration
# does not include (docs/theory/particle.md).
POINTS = 0.85
# Points of the schemes with hourglass control: c dt over the spacing, and c dt over the smallest principal stretch times the spacing.
# The step is 0.5 to 0.98 of the true limit (docs/theory/particle.md).
COURANT, STRETCH = 0.4, 0.9
# Elements by the bound of single elements, which is valid for the mesh (`fe.kernels.stable_dt`). The margin is for stiffening
# of elements while the step is constant.
ELEMENTS = 0.85
# The mesh by its highest frequency (`fe.stability`). The margin is for a mode that becomes the fastest one within ten steps.
MESH = 0.85
LONGEST = 3.0
# Bonds between particle and target (`contact.particle_bonds`): the row sums of their stiffness are a bound; masses are constant.
BONDS = 0.9
# Contact springs: a point whose mass is at least 0.78 of the lightest node's mass may have springs to two bodies.
CONTACT = 0.8
# Motion of the bodies after their equilibrium (`target.equilibrium`): the step is constant between two contact searches.
SETTLED = 0.9
# Conduction among points and among elements: Gershgorin's bound of the fastest rate; conductivities change within the step.
CONDUCTION = 0.9
