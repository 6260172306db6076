#version 300 es
// A surface as one viewpoint sees it, moved to another one. Nearness is disparity above that of infinity.
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D u_nearness;  // of each pixel; negative without a surface
uniform mat3 u_turn;           // [turn | shift] takes pixels of the source to those of the view
uniform vec3 u_shift;
uniform vec2 u_origin;         // first pixel of this piece
uniform vec2 u_size;           // width and height of the view
uniform float u_least;         // least nearness of the piece
uniform float u_reach;         // nearness at the end of the depth buffer
uniform bool u_by_cells;       // instances are cells that may be torn; else vertices are pixels

layout(location = 0) in ivec2 a_cell;  // column and row of its first corner; may be -1
out vec2 v_position;                   // in pixels of this piece

const float EMPTY = 0.02, PIECE_PX = 0.5;
const float TORN_PX = 1.501;  // one and a half is not torn, in spite of rounding
const vec4 NOWHERE = vec4(2.0, 2.0, 2.0, 1.0);

vec3 moved(vec2 position, float nearness) {
  return u_turn * vec3(position + u_origin, 1.0) + nearness * u_shift;
}

vec2 motion(vec2 position, float nearness) {
  vec3 here = moved(position, nearness), flat_there = moved(position, u_least);
  return here.xy / here.z - flat_there.xy / flat_there.z;
}

void position(vec2 position, float nearness) {
  vec3 at = moved(position, nearness);
  float depth = EMPTY * at.z + (1.0 - EMPTY) * nearness / u_reach;
  gl_Position = vec4(2.0 * (at.xy + 0.5 * at.z) / u_size - at.z, 2.0 * depth - at.z, at.z);
  v_position = position;
}

float nearness_at(ivec2 pixel) {
  ivec2 size = textureSize(u_nearness, 0);
  bool inside = pixel.x >= 0 && pixel.y >= 0 && pixel.x < size.x && pixel.y < size.y;
  return inside ? texelFetch(u_nearness, pixel, 0).r : -1.0;
}

ivec2 corner(int number) {
  return ivec2(number & 1, number >> 1);
}

void main() {
  if (!u_by_cells) {
    int width = textureSize(u_nearness, 0).x;
    ivec2 pixel = ivec2(gl_VertexID % width, gl_VertexID / width);
    position(vec2(pixel), texelFetch(u_nearness, pixel, 0).r);
    return;
  }
  // Vertices 0 to 5 are the whole cell, and then six of each corner's own piece.
  const int order[6] = int[6](0, 1, 2, 3, 2, 1);
  float nearness[4];
  vec2 least = vec2(1e9), most = vec2(-1e9);
  bool torn = false;
  for (int k = 0; k < 4; k++) {
    nearness[k] = nearness_at(a_cell + corner(k));
    if (nearness[k] < 0.0) {
      torn = true;
    } else {
      vec2 way = motion(vec2(a_cell + corner(k)), nearness[k]);
      least = min(least, way);
      most = max(most, way);
    }
  }
  vec2 spread = most - least;
  torn = torn || max(spread.x, spread.y) > TORN_PX;
  v_position = vec2(0.0);
  gl_Position = NOWHERE;
  if (gl_VertexID < 6) {
    int k = order[gl_VertexID];
    if (!torn) position(vec2(a_cell + corner(k)), nearness[k]);
    return;
  }
  int own = (gl_VertexID - 6) / 6, part = order[(gl_VertexID - 6) % 6];
  if (torn && nearness[own] >= 0.0) {
    vec2 inward = vec2(corner(part));  // of the piece, from its least column and row
    vec2 first = vec2(a_cell) + vec2(corner(own)) * PIECE_PX;
    position(first + inward * PIECE_PX, nearness[own]);
  }
}
