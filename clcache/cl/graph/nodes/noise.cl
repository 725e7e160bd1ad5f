// Procedural noise. MaterialX's noise of two components is the first two of Float3 (noise2d, noise3d, worleynoise) or two
// plain ones, the second with its place moved by (19, 193, 17) (fractal2d, fractal3d); of four, Float3 and a plain one moved
// by (19, 73, 29) (noise) or as before (fractal).
// needs noise.cl

// Perlin's noise, about -1 .. 1; the plain one equals the first component of Float3.
NODE void Noise2D(float2 UV, float *Out)
{
    *Out = perlin_1(UV, 1, 1.0f, 1.0f);
}
NODE void Noise2D(float2_D UV, float_D *Out)
{
    *Out = perlin_1(UV, 1, 1.0f, 1.0f);
}

NODE void Noise2DFloat3(float2 UV, float3 *Out)
{
    *Out = perlin_3(UV, 1, 1.0f, 1.0f);
}
NODE void Noise2DFloat3(float2_D UV, float3_D *Out)
{
    *Out = perlin_3(UV, 1, 1.0f, 1.0f);
}

NODE void Noise3D(float3 Position, float *Out)
{
    *Out = perlin_1(Position, 1, 1.0f, 1.0f);
}
NODE void Noise3D(float3_D Position, float_D *Out)
{
    *Out = perlin_1(Position, 1, 1.0f, 1.0f);
}

NODE void Noise3DFloat3(float3 Position, float3 *Out)
{
    *Out = perlin_3(Position, 1, 1.0f, 1.0f);
}
NODE void Noise3DFloat3(float3_D Position, float3_D *Out)
{
    *Out = perlin_3(Position, 1, 1.0f, 1.0f);
}

// The sum of up to 32 octaves of Perlin's noise, each with coordinates times Lacunarity and height times Diminish of the one
// before; 0 for none.
NODE void Fractal2D(int Octaves, float2 UV, float Lacunarity, float Diminish, float *Out)
{
    *Out = perlin_1(UV, Octaves, Lacunarity, Diminish);
}
NODE void Fractal2D(int Octaves, float2_D UV, float Lacunarity, float Diminish, float_D *Out)
{
    *Out = perlin_1(UV, Octaves, Lacunarity, Diminish);
}

NODE void Fractal2DFloat3(int Octaves, float2 UV, float Lacunarity, float Diminish, float3 *Out)
{
    *Out = perlin_3(UV, Octaves, Lacunarity, Diminish);
}
NODE void Fractal2DFloat3(int Octaves, float2_D UV, float Lacunarity, float Diminish, float3_D *Out)
{
    *Out = perlin_3(UV, Octaves, Lacunarity, Diminish);
}

NODE void Fractal3D(int Octaves, float3 Position, float Lacunarity, float Diminish, float *Out)
{
    *Out = perlin_1(Position, Octaves, Lacunarity, Diminish);
}
NODE void Fractal3D(int Octaves, float3_D Position, float Lacunarity, float Diminish, float_D *Out)
{
    *Out = perlin_1(Position, Octaves, Lacunarity, Diminish);
}

NODE void Fractal3DFloat3(int Octaves, float3 Position, float Lacunarity, float Diminish, float3 *Out)
{
    *Out = perlin_3(Position, Octaves, Lacunarity, Diminish);
}
NODE void Fractal3DFloat3(int Octaves, float3_D Position, float Lacunarity, float Diminish, float3_D *Out)
{
    *Out = perlin_3(Position, Octaves, Lacunarity, Diminish);
}

// One number from 0 to 1 for each cell of unit size.
NODE void CellNoise2D(float2 UV, float *Out)
{
    *Out = cell_noise(UV);
}
NODE void CellNoise2D(float2 UV, float_D *Out)
{
    *Out = unchanging(cell_noise(UV));
}

NODE void CellNoise3D(float3 Position, float *Out)
{
    *Out = cell_noise(Position);
}
NODE void CellNoise3D(float3 Position, float_D *Out)
{
    *Out = unchanging(cell_noise(Position));
}

// Style 0: the distance to the nearest feature point; Float3: to the three nearest. Other styles: cell noise of the nearest
// one's cell. Jitter 0 to 1 is how far feature points stray from the middles of their cells.
NODE void Worley2D(int Style, float2 UV, float Jitter, float *Out)
{
    Nearest nearest = nearest_features(UV, Jitter);
    *Out = Style == 0 ? nearest.distance[0] : cell_noise(nearest_place(UV, &nearest));
}
NODE void Worley2D(int Style, float2_D UV, float Jitter, float_D *Out)
{
    Nearest nearest = nearest_features(UV.v, Jitter);
    float_D distance = distance_along(&nearest, 0, (float3)(UV.x.x, UV.x.y, 0.0f), (float3)(UV.y.x, UV.y.y, 0.0f));
    *Out = Style == 0 ? distance : unchanging(cell_noise(nearest_place(UV.v, &nearest)));
}

NODE void Worley2DFloat3(int Style, float2 UV, float Jitter, float3 *Out)
{
    Nearest nearest = nearest_features(UV, Jitter);
    float3 distances = (float3)(nearest.distance[0], nearest.distance[1], nearest.distance[2]);
    *Out = Style == 0 ? distances : cell_noise_3(nearest_place(UV, &nearest));
}
NODE void Worley2DFloat3(int Style, float2_D UV, float Jitter, float3_D *Out)
{
    Nearest nearest = nearest_features(UV.v, Jitter);
    float3 along_x = (float3)(UV.x.x, UV.x.y, 0.0f), along_y = (float3)(UV.y.x, UV.y.y, 0.0f);
    float3_D distances = distances_along(&nearest, along_x, along_y);
    *Out = Style == 0 ? distances : unchanging(cell_noise_3(nearest_place(UV.v, &nearest)));
}

NODE void Worley3D(int Style, float3 Position, float Jitter, float *Out)
{
    Nearest nearest = nearest_features(Position, Jitter);
    *Out = Style == 0 ? nearest.distance[0] : cell_noise(nearest_place(Position, &nearest));
}
NODE void Worley3D(int Style, float3_D Position, float Jitter, float_D *Out)
{
    Nearest nearest = nearest_features(Position.v, Jitter);
    float_D distance = distance_along(&nearest, 0, Position.x, Position.y);
    *Out = Style == 0 ? distance : unchanging(cell_noise(nearest_place(Position.v, &nearest)));
}

NODE void Worley3DFloat3(int Style, float3 Position, float Jitter, float3 *Out)
{
    Nearest nearest = nearest_features(Position, Jitter);
    float3 distances = (float3)(nearest.distance[0], nearest.distance[1], nearest.distance[2]);
    *Out = Style == 0 ? distances : cell_noise_3(nearest_place(Position, &nearest));
}
NODE void Worley3DFloat3(int Style, float3_D Position, float Jitter, float3_D *Out)
{
    Nearest nearest = nearest_features(Position.v, Jitter);
    float3_D distances = distances_along(&nearest, Position.x, Position.y);
    *Out = Style == 0 ? distances : unchanging(cell_noise_3(nearest_place(Position.v, &nearest)));
}

// Octaves of simplex noise, each about -1 .. 1, as of Fractal2D.
NODE void SimplexFractal2D(int Octaves, float2 UV, float Lacunarity, float Diminish, float *Out)
{
    *Out = simplex_octaves(UV, Octaves, Lacunarity, Diminish).x;
}
NODE void SimplexFractal2D(int Octaves, float2_D UV, float Lacunarity, float Diminish, float_D *Out)
{
    float3 value_and_slopes = simplex_octaves(UV.v, Octaves, Lacunarity, Diminish);
    *Out = along(value_and_slopes.x, (float2)(value_and_slopes.y, value_and_slopes.z), UV);
}
