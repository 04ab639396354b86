"""Effective properties of a cold coating: stiffness and conductivity of a block cut out of it."""
