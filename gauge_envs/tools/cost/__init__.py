"""Error over cost: what accuracy an engine gives for its processor time."""
