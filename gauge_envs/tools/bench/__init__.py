"""The bench: simple scenes, each with its measurement, that every instrument reads with its own tolerance.

A body drops, slides, rests, creeps, turns or is grasped. The numbers come from `gauge_envs.scoring.estimators`.
"""
