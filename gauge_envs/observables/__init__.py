"""The generalized trajectory g(t): its kinds, its formulas, and how it is read from a simulation."""
