"""A prototype of one rig for everything: bones that only turn, fitted straight to the voxels; see `rig_truth`.

A bone b has a foot f_b, which its parent a carries, and turns by R(θ_b), a rotation by atan |θ| about θ [rad]:

    R(θ) = c (1 + [θ]×) + c² / (1 + c) θ θᵀ,      c = 1 / √(1 + |θ|²)
    f'_b = f'_a + R(θ_a) (f_b - f_a),             f'_0 = f_0 of the ground, which never turns
    x'   = Σ_j w_j (f'_j + R(θ_j) (x - f_j))      linear blending of the bones j that carry the point x

θ_b = Re Σ_k θ_{b,k} q_k: turns are of the world and not of the parent, so turns of several winds add. The blend is that
of every engine's skin, so a GLB with these bones shows these places. docs/decisions/modal.md says what is missing.
"""
