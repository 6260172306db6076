"""Cost volumes of rectified views: what labels cost at each pixel, summed over surfaces, and inferred."""
