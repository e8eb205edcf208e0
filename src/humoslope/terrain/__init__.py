"""Terrains as one height field: registered kinds, tiles by level, MuJoCo import and batched queries."""

from humoslope.terrain.grid import Terrain, TerrainGridCfg, Tile, TileRowCfg
from humoslope.terrain.mjcf import add_terrain
from humoslope.terrain.queries import TerrainQueries
from humoslope.terrain.registry import terrain

__all__ = ["Terrain", "TerrainGridCfg", "TerrainQueries", "Tile", "TileRowCfg", "add_terrain", "terrain"]
