"""Model-independent parts of diffusion: noise schedules, samplers and channel packing."""
