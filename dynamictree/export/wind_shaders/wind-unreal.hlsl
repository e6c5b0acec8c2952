// Unreal: the code of a Custom node in World Position Offset, behind TransformVector (local to world).
// Inputs: Modes (texture object: HDR RGBA16F, no mips, Nearest), Lookup (TexCoord[1]), Seconds (Time + an offset per tree),
// Speed (of the wind, m/s; made for OWN_M_S).
CONSTANTS
#define MODE(part) modes.SampleLevel(point_sampler, lookup + vec2(0.0, (part) * PART_STEP), 0).xyz
struct TreeWind
{
CORE
};
TreeWind tree;
return 100 * tree.wind(Modes, ModesSampler, Lookup, Seconds, Speed).xzy; // centimetres, y and z swapped
