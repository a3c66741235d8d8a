"""Control tasks whose true optimum a law gives: what a policy earns beyond it, reality will not pay."""
