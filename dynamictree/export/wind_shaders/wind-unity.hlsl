// Unity: a Custom Function node (File, name Wind) in a Shader Graph's vertex stage, added to the object position.
// Inputs: Lookup (UV1), Seconds (Time + an offset per tree), Speed (of the wind, m/s; made for OWN_M_S), Modes (modes.exr: sRGB and mipmaps off, no compression), Sampler (Point).
#ifndef TREE_WIND
#define TREE_WIND
CONSTANTS
#define MODE(part) modes.SampleLevel(point_sampler, lookup - vec2(0.0, (part) * PART_STEP), 0).xyz
CORE
void Wind_float(vec2 Lookup, float Seconds, float Speed, UnityTexture2D Modes, UnitySamplerState Sampler, out vec3 Displacement)
{
    Displacement = wind(Modes.tex, Sampler.samplerstate, Lookup, Seconds, Speed) * vec3(-1, 1, 1); // glTFast mirrors x
}
#endif
