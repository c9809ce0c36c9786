"""Studies: sweeps, tuning, comparisons of controllers, stiffness tests, and tests on a rig."""
