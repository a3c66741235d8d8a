"""References for scores: bands of real trials, published baselines, laws, imported trials."""
