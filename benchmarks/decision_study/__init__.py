"""Logs whose truth is known, the policies that are learned from them, and rules that decide by them."""
