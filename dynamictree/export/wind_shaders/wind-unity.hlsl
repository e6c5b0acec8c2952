// Unity: a Custom Function node (File, name Wind) in a Shader Graph's vertex stage, added to the object position.
// Inputs: Lookup (UV1), Place (object position), Poses (the Custom Render Texture of wind-unity.shader), Sampler (Point).
#ifndef TREE_WIND
#define TREE_WIND
LAYOUT
#define POSE(at, part) poses.SampleLevel(point_sampler, vec2((at).x, ((at).y + (part)) / 4.0), 0).xyz
SURFACE
void Wind_float(vec2 Lookup, vec3 Place, UnityTexture2D Poses, UnitySamplerState Sampler, out vec3 Displacement)
{
    vec2 lookup = vec2(Lookup.x, 1 - Lookup.y); // glTFast turns v, and mirrors x
    Displacement = wind(Poses.tex, Sampler.samplerstate, lookup, Place * vec3(-1, 1, 1)) * vec3(-1, 1, 1);
}
#endif
