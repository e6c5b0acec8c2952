// Unreal: the code of a Custom node in World Position Offset, behind TransformVector (local to world).
// Inputs: Poses (texture object: the render target of wind-unreal-poses.hlsl, Nearest), Lookup (TexCoord[1], full precision
// UVs), Place (PreSkinnedLocalPosition).
LAYOUT
#define POSE(at, part) poses.SampleLevel(point_sampler, vec2((at).x, ((at).y + (part)) / 4.0), 0).xyz
struct TreeWind
{
SURFACE
};
TreeWind tree;
return 100 * tree.wind(Poses, PosesSampler, Lookup, Place.xzy / 100).xzy; // centimetres, y and z swapped
