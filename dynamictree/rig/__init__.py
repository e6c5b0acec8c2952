"""Rig of a tree: bones that only rotate, their rotations in each mode of the wind, and skinning weights.

A bone b has a foot f_b, carried by its parent a, and rotates by R(θ_b), a rotation by atan |θ| about θ [rad]:

    R(θ) = c (1 + [θ]×) + c² / (1 + c) θ θᵀ,      c = 1 / √(1 + |θ|²)
    f'_b = f'_a + R(θ_a) (f_b - f_a),             f'_0 = f_0 of the ground, which never rotates
    x'   = Σ_j w_j (f'_j + R(θ_j) (x - f_j))      linear blend skinning by the bones j that carry x

θ_b = Re Σ_k θ_{b,k} q_k: rotations are relative to the world and not to the parent, so those of several winds add. All
engines use this skinning, so a GLB with these bones shows the same positions. `surface_skeleton.py` finds bones and
weights, `turn_fit.py` fits the rotations to a spectrum, and `pose.py` evaluates them.
"""
