"""The network: amplitude from shape and wind, and a diffusion of the whitened spectrum; presets small and paper."""
