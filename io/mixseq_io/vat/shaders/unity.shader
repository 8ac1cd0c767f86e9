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
        sampler2D _Points, _Normals, _Coefficients;
        float _Rate;
        struct Input { float4 color : COLOR; };

        // Rows of textures are counted from below. What makes surface shaders does not know Load().
        #define TEXEL(image, x, y, width, height) tex2Dlod(image, float4((x + 0.5) / (width), 1 - (y + 0.5) / (height), 0, 0))

        void vert(inout appdata_full v)
        {
            float2 lookup = float2(v.texcoord1.x, 1 - v.texcoord1.y);
            float2 at = floor(lookup * float2(@WIDTH@, @HEIGHT@));
            float frame = fmod(_Time.y * _Rate, @FRAMES@ - 1);
            float3 position = 0, normal = 0;
            for (int step = 0; step < 2; step++)
            {
                float now = floor(frame) + step;
                float share = step ? frac(frame) : 1 - frac(frame);
                #if @LOW_RANK@
                float column = round(TEXEL(_Points, at.x, at.y, @WIDTH@, @HEIGHT@).r * @PART_SCALE@) * 4 * @LAYERS@;
                for (int layer = 0; layer < @LAYERS@; layer++)
                {
                    float row = at.y + layer * @ROWS@;
                    float4 basis = TEXEL(_Points, at.x, row + @ROWS@, @WIDTH@, @HEIGHT@);
                    float4 turned = TEXEL(_Normals, at.x, row, @WIDTH@, @NORMALS_HEIGHT@);
                    for (int channel = 0; channel < 4; channel++)
                    {
                        float3 coarse = TEXEL(_Coefficients, column, now, @COLUMNS@, 2 * @FRAMES@).rgb;
                        float3 fine = TEXEL(_Coefficients, column, now + @FRAMES@, @COLUMNS@, 2 * @FRAMES@).rgb;
                        float3 there = @COEFFICIENTS_OFFSET@ + @COEFFICIENTS_SCALE@ * (coarse + fine / 65535.0);
                        position += share * (@POINTS_OFFSET@ + @POINTS_SCALE@ * basis[channel]) * there;
                        normal += share * (@NORMALS_OFFSET@ + @NORMALS_SCALE@ * turned[channel]) * there;
                        column++;
                    }
                }
                #else
                float3 here = TEXEL(_Points, at.x, at.y + now * @ROWS@, @WIDTH@, @HEIGHT@).rgb;
                float3 side = TEXEL(_Normals, at.x, at.y + now * @ROWS@, @WIDTH@, @HEIGHT@).rgb;
                position += share * (float3(@POINTS_OFFSET@) + float3(@POINTS_SCALE@) * here);
                normal += share * (float3(@NORMALS_OFFSET@) + float3(@NORMALS_SCALE@) * side);
                #endif
            }
            v.vertex.xyz = position * float3(-1, 1, 1);
            v.normal = normalize(normal * float3(-1, 1, 1));
        }

        void surf(Input IN, inout SurfaceOutputStandard o) { o.Albedo = 0.8; o.Smoothness = 0.3; }
        ENDCG
    }
}
