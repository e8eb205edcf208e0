"""Measuring trained policies: protocols, metrics, statistics, tables and plots."""
