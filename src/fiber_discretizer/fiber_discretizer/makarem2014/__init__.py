"""The discretization of Makarem et al. (2014), arXiv 1410.1181, with its errata corrected."""
