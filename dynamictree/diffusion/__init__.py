"""Model-independent parts of diffusion: noise schedules, samplers, losses and channel packing."""
