"""What is done to records before a fit: band, means, delays, drift, integrators, gaps."""
