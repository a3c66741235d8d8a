"""What simulations are held against: bands over real trials, published baselines, laws, imported trials."""
