#version 300 es
// Points and lines of the world as a camera sees them, at the depths that surfaces have.
precision highp float;

uniform mat3 u_turn;      // [turn | shift] takes the world to pixels of the view
uniform vec3 u_shift;
uniform vec2 u_size;      // width and height of the view
uniform float u_reach;    // inverse depth at the end of the depth buffer
uniform float u_behind;   // below 1: as if it were farther away by so much
uniform float u_diameter; // of a point at unit distance, in texels
uniform vec2 u_sizes;     // least and largest diameter

layout(location = 0) in vec3 a_position;
layout(location = 1) in vec4 a_colour;
out vec4 v_colour;

const float EMPTY = 0.02;

void main() {
  vec3 at = u_turn * a_position + u_shift;
  float depth = EMPTY * at.z + (1.0 - EMPTY) * u_behind / u_reach;
  vec2 place = 2.0 * (at.xy + 0.5 * at.z) / u_size - at.z;
  gl_Position = vec4(place.x, -place.y, 2.0 * depth - at.z, at.z);
  gl_PointSize = clamp(u_diameter / max(at.z, 1e-6), u_sizes.x, u_sizes.y);
  v_colour = a_colour;
}
