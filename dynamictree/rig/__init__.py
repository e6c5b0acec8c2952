"""The rig: bones that only turn, how each turns in each mode of the wind, and which bones carry each point.

A bone b has a foot f_b, which its parent a carries, and turns by R(θ_b), a rotation by atan |θ| about θ [rad]:

    R(θ) = c (1 + [θ]×) + c² / (1 + c) θ θᵀ,      c = 1 / √(1 + |θ|²)
    f'_b = f'_a + R(θ_a) (f_b - f_a),             f'_0 = f_0 of the ground, which never turns
    x'   = Σ_j w_j (f'_j + R(θ_j) (x - f_j))      linear blending of the bones j that carry the point x

θ_b = Re Σ_k θ_{b,k} q_k: turns are of the world and not of the parent, so turns of several winds add. The blend is that
of every engine's skin, so a GLB with these bones shows these places. Bones and weights are found in
`surface_skeleton.py`, turns are fitted to a spectrum in `turn_fit.py`; all else evaluates `pose.py`.
"""
