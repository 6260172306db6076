#version 300 es
// Round points, lines, or a picture: colours are positions in it.
precision highp float;

uniform bool u_round;
uniform bool u_pictured;
uniform sampler2D u_picture;

in vec4 v_colour;
layout(location = 0) out vec4 colour;

void main() {
  if (u_round && distance(gl_PointCoord, vec2(0.5)) > 0.5) discard;
  colour = vec4(u_pictured ? texture(u_picture, v_colour.xy).rgb : v_colour.rgb, 1.0);
}
