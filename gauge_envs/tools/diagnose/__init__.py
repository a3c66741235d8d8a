"""Split the error of an episode into release time, offset, rate and the rest."""
