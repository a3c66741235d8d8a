"""`gauge reference`: the refined solution of a scene, with its uncertainty."""
