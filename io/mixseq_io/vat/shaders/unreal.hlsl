// Vertex animation textures written by mixseq, for Unreal: the code of a Custom node (output: float3) in a material.
//
// Inputs, in this order: Points, Normals, Coefficients (texture objects), Lookup (TexCoord[1]), Frame (Time times
// @FPS@, modulo @FRAMES@ - 1), Rest (pre-skinned local position). Add an output Normal (float3) to the node.
// World position offset: the output, transformed from local to world. Import the textures without sRGB, mipmaps and
// compression (VectorDisplacementmap or HDR), filter nearest. Importers of glTF have centimetres and z up; so has this.
#define LOW_RANK @LOW_RANK@
struct Vat
{
    int2 Place(float2 At, int Layer) { return int2(At * float2(@WIDTH@, @HEIGHT@)) + int2(0, Layer * @ROWS@); }
#if LOW_RANK
    float3 Coefficient(Texture2D Image, int Column, int Number)
    {
        float3 Coarse = Image.Load(int3(Column, Number, 0)).rgb;
        float3 Fine = Image.Load(int3(Column, Number + @FRAMES@, 0)).rgb;
        return @COEFFICIENTS_OFFSET@ + @COEFFICIENTS_SCALE@ * (Coarse + Fine / 65535.0);
    }
#endif
} V;
int Before = (int)Frame;
float3 Point = 0;
float3 Direction = 0;
#if LOW_RANK
int Column = (int)round(Points.Load(int3(V.Place(Lookup, 0), 0)).r * @PART_SCALE@) * 4 * @LAYERS@;
for (int Layer = 0; Layer < @LAYERS@; Layer++)
{
    float4 Basis = @POINTS_OFFSET@ + @POINTS_SCALE@ * Points.Load(int3(V.Place(Lookup, Layer + 1), 0));
    float4 Turned = @NORMALS_OFFSET@ + @NORMALS_SCALE@ * Normals.Load(int3(V.Place(Lookup, Layer), 0));
    for (int Channel = 0; Channel < 4; Channel++)
    {
        float3 There = lerp(
            V.Coefficient(Coefficients, Column, Before), V.Coefficient(Coefficients, Column, Before + 1), frac(Frame));
        Point += Basis[Channel] * There;
        Direction += Turned[Channel] * There;
        Column++;
    }
}
#else
for (int Step = 0; Step < 2; Step++)
{
    float Share = Step ? frac(Frame) : 1 - frac(Frame);
    int3 At = int3(V.Place(Lookup, Before + Step), 0);
    Point += Share * (float3(@POINTS_OFFSET@) + float3(@POINTS_SCALE@) * Points.Load(At).rgb);
    Direction += Share * (float3(@NORMALS_OFFSET@) + float3(@NORMALS_SCALE@) * Normals.Load(At).rgb);
}
#endif
Normal = normalize(Direction.xzy);
return Point.xzy * 100 - Rest;
