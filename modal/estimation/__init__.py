"""Candidates, free runs, the likelihood of output error, its refinement and its covariance."""
