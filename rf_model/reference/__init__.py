"""A model-based reference for what a surface and its base station can do with known channels."""
