"""Embedded coding of wavelet coefficients by zerotrees: SPIHT with contexts."""
