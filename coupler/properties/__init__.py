"""Effective properties of a cold coating: stiffness and conductivities of a block of it."""
