"""Pictures of scenes, drawn with MuJoCo for every engine."""
