"""Registered tasks; every file in this folder is imported."""

from humoslope.plugins import import_all

import_all(__name__, __path__)
