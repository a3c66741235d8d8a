"""The generalized trajectory g(t): kinds, formulas, and observers of a simulation."""
