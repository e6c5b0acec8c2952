"""The shipped model: amplitudes by regression, phases by diffusion."""
