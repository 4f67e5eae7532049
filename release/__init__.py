"""Builds a release: wheel, sdist, images and their bills of materials, with one signature."""
