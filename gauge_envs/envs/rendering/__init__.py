"""Pictures of scenes, drawn by MuJoCo for every engine."""
