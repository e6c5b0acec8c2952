// Unity: the material of a Custom Render Texture (POSES_WIDTH x POSES_HEIGHT, ARGB Float, no mipmaps, Point, update mode Realtime)
// that computes the bones. Bones: bones.exr (sRGB and mipmaps off, no compression, no resizing).
Shader "Tree/Wind Poses"
{
    Properties
    {
        [NoScaleOffset] _Bones ("Bones", 2D) = "black" {}
        _Speed ("Mean speed of the wind [m/s]", Float) = OWN_M_S
        _Offset ("Offset of this tree's wind [s]", Float) = 0
    }
    SubShader
    {
        Blend One Zero
        Pass
        {
            CGPROGRAM
            #include "UnityCustomRenderTexture.cginc"
            #pragma vertex CustomRenderTextureVertexShader
            #pragma fragment frag
            #pragma target 4.5
            Texture2D _Bones;
            SamplerState point_clamp_sampler;
            float _Speed, _Offset;
CONSTANTS
#define BONE(at, part) bones.SampleLevel(point_sampler, float2((at).x, 1 - ((at).y + (part)) / NUM_PARTS), 0).xyz
CORE
            float4 frag(v2f_customrendertexture texel) : SV_Target
            {
                return float4(pose(_Bones, point_clamp_sampler, texel.localTexcoord.xy, _Time.y + _Offset, _Speed), 1);
            }
            ENDCG
        }
    }
}
