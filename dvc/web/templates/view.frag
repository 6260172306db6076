#version 300 es
// Mean by weight of the sources that show the nearest surface; pixels without any are marked or filled.
precision highp float;
precision highp int;
precision highp sampler2DArray;
precision highp sampler2D;

const int MAX_SOURCES = 4;

uniform sampler2DArray u_colour;
uniform sampler2DArray u_depth;
uniform sampler2D u_palette;
uniform int u_count;
uniform mat3 u_back[MAX_SOURCES];    // inverse of the turn of each source
uniform vec3 u_shift[MAX_SOURCES];
uniform float u_weight[MAX_SOURCES];
uniform vec3 u_epipole;
uniform float u_scale;               // texels of a pixel of the view
uniform float u_stripe_px;
uniform float u_reach;
uniform vec2 u_range;                // least and largest nearness
uniform bool u_show_depth;
uniform bool u_fill;                 // pixels without a source continue the background
uniform int u_farthest;              // largest distance of that in texels,
uniform bool u_open;                 // on both sides of it if the rest is left as it was; else it is marked
uniform bool u_leads;                // the first source is right at all pixels that it shows

layout(location = 0) out vec4 colour;

const float EMPTY = 0.02;
const float SAME_SURFACE_PX = 1.001;  // whole pixels count as equal in spite of rounding

struct Shown {
  vec3 colour;
  float nearness;  // negative without a surface
};

float nearness_of(float depth) {
  return depth <= 0.0 ? -1.0 : (depth - EMPTY) / (1.0 - EMPTY) * u_reach;
}

float nearest(ivec2 texel) {
  float depth = texelFetch(u_depth, ivec3(texel, 0), 0).r;
  if (u_leads && depth > 0.0) return nearness_of(depth);
  for (int k = 1; k < u_count; k++) depth = max(depth, texelFetch(u_depth, ivec3(texel, k), 0).r);
  return nearness_of(depth);
}

Shown shown(ivec2 texel) {
  float front = nearest(texel), total = 0.0;
  vec3 sum = vec3(0.0);
  if (front < 0.0) return Shown(vec3(0.0), -1.0);
  vec3 at = vec3((vec2(texel) + 0.5) / u_scale - 0.5, 1.0);
  for (int k = 0; k < u_count; k++) {
    float own = nearness_of(texelFetch(u_depth, ivec3(texel, k), 0).r);
    if (own < 0.0) continue;
    vec3 here = u_back[k] * (at - own * u_shift[k]), before = u_back[k] * (at - front * u_shift[k]);
    if (distance(here.xy / here.z, before.xy / before.z) > SAME_SURFACE_PX) continue;
    sum += u_weight[k] * texelFetch(u_colour, ivec3(texel, k), 0).rgb;
    total += u_weight[k];
  }
  if (total == 0.0) return Shown(vec3(0.0), -1.0);
  return Shown(sum / total, front);
}

#ifdef FILLS
// The first texel in a direction that shows something, and how far it is; w is 0 if there is none.
ivec4 found(vec2 start, vec2 direction) {
  ivec2 size = textureSize(u_colour, 0).xy;
  for (int k = 1; k <= u_farthest; k++) {
    ivec2 texel = ivec2(floor(start + float(k) * direction));
    if (texel.x < 0 || texel.y < 0 || texel.x >= size.x || texel.y >= size.y) break;
    if (nearest(texel) >= 0.0) return ivec4(texel, k, 1);
  }
  return ivec4(0);
}

// The farther end of a line through a hole continues into it; ends on one surface are mixed.
Shown between(ivec4 one, ivec4 other) {
  if (one.w + other.w == 0 || (u_open && other.w == 0)) return Shown(vec3(0.0), -1.0);
  if (one.w == 0) return shown(other.xy);
  if (other.w == 0) return shown(one.xy);
  Shown a = shown(one.xy), b = shown(other.xy);
  if (abs(a.nearness - b.nearness) < 0.04 * (u_range.y - u_range.x)) {
    float share = float(one.z) / float(one.z + other.z);
    return Shown(mix(a.colour, b.colour, share), mix(a.nearness, b.nearness, share));
  }
  if (a.nearness < b.nearness) return a;
  return b;
}

Shown beside(vec2 start, vec2 direction) {
  ivec4 one = found(start, direction);
  if (u_open && one.w == 0) return Shown(vec3(0.0), -1.0);
  return between(one, found(start, -direction));
}

Shown filled(vec2 start) {
  vec2 at = start / u_scale - 0.5;
  vec2 line = u_epipole.xy - at * u_epipole.z;
  if (!u_open && length(line) > 1e-6) {
    Shown along = beside(start, normalize(line));
    if (along.nearness >= 0.0) return along;
  }
  Shown across = beside(start, vec2(1.0, 0.0));
  if (across.nearness >= 0.0) return across;
  return beside(start, vec2(0.0, 1.0));
}

#endif
vec3 hatched() {
  float position = fract((gl_FragCoord.x + gl_FragCoord.y) / u_stripe_px);
  return position < 0.5 ? vec3(0.10, 0.10, 0.12) : vec3(0.93, 0.45, 0.10);
}

void main() {
  float height = float(textureSize(u_colour, 0).y);
  vec2 at = vec2(gl_FragCoord.x, height - gl_FragCoord.y);
  Shown here = shown(ivec2(floor(at)));
#ifdef FILLS
  if (here.nearness < 0.0 && u_fill) here = filled(at);
#endif
  if (here.nearness < 0.0 && u_open) discard;
  gl_FragDepth = here.nearness < 0.0 ? 0.0 : EMPTY + (1.0 - EMPTY) * here.nearness / u_reach;
  if (here.nearness < 0.0) {
    colour = vec4(hatched(), 1.0);
  } else if (u_show_depth) {
    float position = clamp((here.nearness - u_range.x) / (u_range.y - u_range.x), 0.0, 1.0);
    colour = vec4(texture(u_palette, vec2((position * 255.0 + 0.5) / 256.0, 0.5)).rgb, 1.0);
  } else {
    colour = vec4(here.colour, 1.0);
  }
}
