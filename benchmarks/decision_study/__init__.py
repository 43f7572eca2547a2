"""Logs whose truth is known, the policies that are learned from them, and rules that decide by them."""

from decision_study import bandits, continuous, tables

FAMILIES = {family.name: family for family in (*bandits.FAMILIES, *tables.FAMILIES, *continuous.FAMILIES)}
