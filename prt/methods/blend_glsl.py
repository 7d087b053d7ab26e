"""Source of the shader that blends a lightmap basis on screen (Belcour 2022, section 5.2): GLSL 3.30."""

#: the textures of the G-buffer, in the order of their texture units; the basis comes after them
SCREEN = ("place", "scale", "direct")
BASIS_UNIT = len(SCREEN)

#: ahead of it come ``#version 330`` and definitions of
#: LAYERS: of the basis texture
#: CHANNELS: of the basis, 1 or 3
#: GAMMA: the power of the inverse gamma correction; left undefined for none
#: EXACT: 1 to mix four texels here, 0 to leave it to the texture unit
#: INDIRECT: 0 for the shader without indirect light
FRAGMENT = """
uniform sampler2D place, scale, direct;
uniform vec3 ambient;
out vec4 color;

#if INDIRECT
uniform sampler2DArray basis;
#if CHANNELS == 1
layout(std140) uniform Coefficients { mat4x3 coefficients[LAYERS]; };
#else
layout(std140) uniform Coefficients { vec4 coefficients[LAYERS]; };
#endif

vec3 indirect(vec2 uv) {
#if EXACT
    ivec2 last = textureSize(basis, 0).xy - 1;
    vec2 at = clamp(uv * vec2(last + 1) - 0.5, vec2(0.0), vec2(last));
    ivec2 low = ivec2(at), high = min(low + 1, last);
    vec2 share = at - vec2(low);
#endif
    vec3 sum = vec3(0.0);
    for (int k = 0; k < LAYERS; ++k) {
#if EXACT
        vec4 top = mix(texelFetch(basis, ivec3(low, k), 0),
                       texelFetch(basis, ivec3(high.x, low.y, k), 0), share.x);
        vec4 bottom = mix(texelFetch(basis, ivec3(low.x, high.y, k), 0),
                          texelFetch(basis, ivec3(high, k), 0), share.x);
        vec4 elements = mix(top, bottom, share.y);
#else
        vec4 elements = textureLod(basis, vec3(uv, k), 0.0);
#endif
#if CHANNELS == 1
        sum += coefficients[k] * elements;
#else
        sum += coefficients[k].rgb * elements.rgb;
#endif
    }
#ifdef GAMMA
    sum = pow(max(sum, 0.0), vec3(GAMMA));
#endif
    return sum;
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 where = texelFetch(place, pixel, 0);
    if (where.z == 0.0) {
        color = vec4(0.0);
        return;
    }
#if INDIRECT
    vec3 light = indirect(where.xy);
#else
    vec3 light = ambient;  // zero; a uniform, so that scale is read all the same
#endif
    color = vec4(texelFetch(direct, pixel, 0).rgb + texelFetch(scale, pixel, 0).rgb * light, 1.0);
}
"""
