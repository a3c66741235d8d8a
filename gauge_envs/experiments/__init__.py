"""Experiments: task files and files of users, each resolved to a scene and how it is observed and scored."""
