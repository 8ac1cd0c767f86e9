// Vertex animation textures written by mixseq, for Unity (built-in render pipeline). Import the textures without sRGB,
// compression, mipmaps, filter, resizing or alpha. mesh.glb has the places in the textures in the second set of
// texture coordinates. Importers of glTF turn v upside down and mirror x; so does this.
Shader "mixseq/VertexAnimation"
{
    Properties
    {
        _Points ("points", 2D) = "black" {}
        _Normals ("normals", 2D) = "black" {}
        _Coefficients ("coefficients", 2D) = "black" {}
        _Rate ("frames per second", Float) = @FPS@
    }
    SubShader
    {
        Tags { "RenderType" = "Opaque" }
        CGPROGRAM
        #pragma surface surf Standard vertex:vert addshadow
        #pragma target 4.5
        #include "UnityCG.cginc"
        #define LOW_RANK @LOW_RANK@
        Texture2D _Points, _Normals, _Coefficients;
        float _Rate;
        struct Input { float4 color : COLOR; };

        float4 texel(Texture2D image, int2 at, int height) { return image.Load(int3(at.x, height - 1 - at.y, 0)); }

        int2 place(float2 lookup, int layer)
        {
            return int2(float2(lookup.x, 1 - lookup.y) * float2(@WIDTH@, @HEIGHT@)) + int2(0, layer * @ROWS@);
        }

        #if LOW_RANK
        float3 coefficient(int column, int frame)
        {
            float3 coarse = texel(_Coefficients, int2(column, frame), 2 * @FRAMES@).rgb;
            float3 fine = texel(_Coefficients, int2(column, frame + @FRAMES@), 2 * @FRAMES@).rgb;
            return @COEFFICIENTS_OFFSET@ + @COEFFICIENTS_SCALE@ * (coarse + fine / 65535.0);
        }
        #endif

        void vert(inout appdata_full v)
        {
            float frame = fmod(_Time.y * _Rate, @FRAMES@ - 1);
            int before = (int)frame;
            float3 position = 0, normal = 0;
            #if LOW_RANK
            int column = (int)round(texel(_Points, place(v.texcoord1.xy, 0), @HEIGHT@).r * @PART_SCALE@) * 4 * @LAYERS@;
            for (int layer = 0; layer < @LAYERS@; layer++)
            {
                float4 basis = @POINTS_OFFSET@ + @POINTS_SCALE@ * texel(_Points, place(v.texcoord1.xy, layer + 1), @HEIGHT@);
                float4 turned = @NORMALS_OFFSET@ + @NORMALS_SCALE@ * texel(_Normals, place(v.texcoord1.xy, layer), @NORMALS_HEIGHT@);
                for (int channel = 0; channel < 4; channel++)
                {
                    float3 there = lerp(coefficient(column, before), coefficient(column, before + 1), frac(frame));
                    position += basis[channel] * there;
                    normal += turned[channel] * there;
                    column++;
                }
            }
            #else
            for (int step = 0; step < 2; step++)
            {
                float share = step ? frac(frame) : 1 - frac(frame);
                int2 at = place(v.texcoord1.xy, before + step);
                position += share * (float3(@POINTS_OFFSET@) + float3(@POINTS_SCALE@) * texel(_Points, at, @HEIGHT@).rgb);
                normal += share * (float3(@NORMALS_OFFSET@) + float3(@NORMALS_SCALE@) * texel(_Normals, at, @HEIGHT@).rgb);
            }
            #endif
            v.vertex.xyz = position * float3(-1, 1, 1);
            v.normal = normalize(normal * float3(-1, 1, 1));
        }

        void surf(Input IN, inout SurfaceOutputStandard o) { o.Albedo = 0.8; o.Smoothness = 0.3; }
        ENDCG
    }
}
