// Unreal: the code of a Custom node in the Emissive Color of an unlit material (Allow Negative Emissive Color) that a
// Blueprint draws each tick into a render target (Draw Material to Render Target; POSES_WIDTH x POSES_HEIGHT, RGBA32f).
// Inputs: Bones (texture object: bones.exr as HDR RGBA16F, no mips, Nearest), Texel (TexCoord[0]), Seconds (Time + an offset
// per tree), Speed (of the wind, m/s; made for OWN_M_S).
CONSTANTS
#define BONE(at, part) bones.SampleLevel(point_sampler, vec2((at).x, ((at).y + (part)) / NUM_PARTS), 0).xyz
struct TreeWind
{
CORE
};
TreeWind tree;
return tree.pose(Bones, BonesSampler, Texel, Seconds, Speed);
