"""Networks, distributions and optimiser steps: pure functions and pytrees of arrays."""
