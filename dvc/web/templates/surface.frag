#version 300 es
// Its colours, between pixels by cubic convolution (Catmull-Rom), or with lines on it.
precision highp float;
precision highp sampler2D;

uniform sampler2D u_picture;
uniform bool u_lines;

in vec2 v_position;
layout(location = 0) out vec4 colour;

const float LINE_DISTANCE_PX = 8.0;

vec3 cubic(vec2 position) {
  vec2 size = vec2(textureSize(u_picture, 0));
  vec2 base = floor(position), s = position - base;
  vec2 w0 = s * (-0.5 + s * (1.0 - 0.5 * s));
  vec2 w1 = 1.0 + s * s * (-2.5 + 1.5 * s);
  vec2 w2 = s * (0.5 + s * (2.0 - 1.5 * s));
  vec2 w3 = s * s * (-0.5 + 0.5 * s);
  vec2 middle = w1 + w2;
  vec2 first = (base - 0.5) / size, last = (base + 2.5) / size;
  vec2 centre = (base + 0.5 + w2 / middle) / size;
  vec3 rows0 = w0.x * texture(u_picture, vec2(first.x, first.y)).rgb
      + middle.x * texture(u_picture, vec2(centre.x, first.y)).rgb
      + w3.x * texture(u_picture, vec2(last.x, first.y)).rgb;
  vec3 rows1 = w0.x * texture(u_picture, vec2(first.x, centre.y)).rgb
      + middle.x * texture(u_picture, centre).rgb
      + w3.x * texture(u_picture, vec2(last.x, centre.y)).rgb;
  vec3 rows2 = w0.x * texture(u_picture, vec2(first.x, last.y)).rgb
      + middle.x * texture(u_picture, vec2(centre.x, last.y)).rgb
      + w3.x * texture(u_picture, vec2(last.x, last.y)).rgb;
  return w0.y * rows0 + middle.y * rows1 + w3.y * rows2;
}

void main() {
  vec3 shown = clamp(cubic(v_position), 0.0, 1.0);
  if (u_lines) {
    vec2 cells = v_position / LINE_DISTANCE_PX;
    vec2 away = abs(fract(cells - 0.5) - 0.5) / max(fwidth(cells), 1e-6);
    shown = mix(vec3(0.75, 0.95, 1.0), 0.35 * shown, clamp(min(away.x, away.y), 0.0, 1.0));
  }
  colour = vec4(shown, 1.0);
}
