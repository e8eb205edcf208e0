"""Surfaces, profiles and training grids; a new file is registered by being here."""

from humoslope.plugins import import_all

import_all(__name__, __path__)
