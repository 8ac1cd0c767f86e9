// Vertex animation textures written by mixseq, for Unreal: the code of a Custom node (output: float3) in a material.
//
// Inputs, in this order: Points, Normals, Coefficients (texture objects), Lookup (TexCoord[1]), Frame (Time times
// @FPS@, modulo @FRAMES@ - 1), Rest (pre-skinned local position). Add an output Normal (float3) to the node.
// World position offset: the output, transformed from local to world. Import the textures without sRGB, mipmaps and
// compression (VectorDisplacementmap or HDR), filter nearest. Importers of glTF have centimetres and z up; so has this.
int2 At = int2(Lookup * float2(@WIDTH@, @HEIGHT@));
float3 Point = 0;
float3 Direction = 0;
for (int Step = 0; Step < 2; Step++)
{
    int Now = (int)Frame + Step;
    float Share = Step ? frac(Frame) : 1 - frac(Frame);
#if @LOW_RANK@
    int Column = (int)round(Points.Load(int3(At, 0)).r * @PART_SCALE@) * 4 * @LAYERS@;
    for (int Layer = 0; Layer < @LAYERS@; Layer++)
    {
        float4 Basis = @POINTS_OFFSET@ + @POINTS_SCALE@ * Points.Load(int3(At.x, At.y + (Layer + 1) * @ROWS@, 0));
        float4 Turned = @NORMALS_OFFSET@ + @NORMALS_SCALE@ * Normals.Load(int3(At.x, At.y + Layer * @ROWS@, 0));
        for (int Channel = 0; Channel < 4; Channel++)
        {
            float3 Coarse = Coefficients.Load(int3(Column, Now, 0)).rgb;
            float3 Fine = Coefficients.Load(int3(Column, Now + @FRAMES@, 0)).rgb;
            float3 There = @COEFFICIENTS_OFFSET@ + @COEFFICIENTS_SCALE@ * (Coarse + Fine / 65535.0);
            Point += Share * Basis[Channel] * There;
            Direction += Share * Turned[Channel] * There;
            Column++;
        }
    }
#else
    int3 Texel = int3(At.x, At.y + Now * @ROWS@, 0);
    Point += Share * (float3(@POINTS_OFFSET@) + float3(@POINTS_SCALE@) * Points.Load(Texel).rgb);
    Direction += Share * (float3(@NORMALS_OFFSET@) + float3(@NORMALS_SCALE@) * Normals.Load(Texel).rgb);
#endif
}
Normal = normalize(Direction.xzy);
return Point.xzy * 100 - Rest;
