"""Values that packages state in their Python source, read without importing the packages."""
