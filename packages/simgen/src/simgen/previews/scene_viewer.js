"use strict";
// Draws each <canvas class="scene"> from the JSON element after it. Matrices are 4 x 4, row by row; z is up.

const floats = text => new Float32Array(bytes(text).buffer);
const bytes = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
const rows = (array, size) =>
  Array.from({length: array.length / size}, (_, i) => array.subarray(size * i, size * i + size));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

const VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 color;
uniform mat4 clip_from_cam, cam_from_world, world_from_mesh;
out vec3 seen, tint;
void main() {
  vec4 at = cam_from_world * (world_from_mesh * vec4(position, 1.0));
  seen = at.xyz;
  tint = color;
  gl_Position = clip_from_cam * at;
  gl_PointSize = 2.5;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 seen, tint;
uniform bool lit;
out vec4 pixel;
void main() {
  float light = 1.0;
  if (lit) {  // flat: the triangle's normal, by derivatives; the lamp is at the camera's shoulder
    vec3 normal = normalize(cross(dFdx(seen), dFdy(seen)));
    light = 0.3 + 0.7 * abs(dot(normal, normalize(vec3(-0.4, -0.6, -1.0))));
  }
  pixel = vec4(tint * light, 1.0);
}`;

function program(gl) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  return made;
}

// Positions, colors (one each, or one for all), and perhaps indices, as something that can be drawn.
function shape(gl, mode, positions, colors, indices) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  for (const [location, data] of [[0, positions], [1, colors]]) {
    if (data === null) continue;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(location);
    gl.vertexAttribPointer(location, 3, gl.FLOAT, false, 0, 0);
  }
  if (indices) {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
  }
  return color => {
    gl.bindVertexArray(array);
    if (color) gl.vertexAttrib3fv(1, color);
    if (indices) gl.drawElements(mode, indices.length, gl.UNSIGNED_INT, 0);
    else gl.drawArrays(mode, 0, positions.length / 3);
  };
}

// The twelve edges of the bin, whose floor's middle is the world's origin.
function binLines({width, depth, height}) {
  const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => [a * width / 2, b * depth / 2]);
  return new Float32Array(corners.flatMap((a, i) => {
    const b = corners[(i + 1) % 4];
    return [...a, 0, ...b, 0, ...a, height, ...b, height, ...a, 0, ...a, height];
  }));
}

// A point of the camera's frame in the world: the inverse of a rigid transform, applied.
function inWorld(pose, point) {
  const d = [0, 1, 2].map(row => point[row] - pose[4 * row + 3]);
  return [0, 1, 2].map(column => d[0] * pose[column] + d[1] * pose[4 + column] + d[2] * pose[8 + column]);
}

function frustumLines(poses, camera, depth) {
  const corner = (u, v) => [(u - camera.cx) / camera.fx * depth, (v - camera.cy) / camera.fy * depth, depth];
  const {width, height} = camera, corners = [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)];
  return new Float32Array(poses.flatMap(pose => {
    const eye = inWorld(pose, [0, 0, 0]), ends = corners.map(point => inWorld(pose, point));
    return ends.flatMap((end, i) => [...eye, ...end, ...end, ...ends[(i + 1) % 4]]);
  }));
}

// Looking at `target` from `distance`, as an OpenCV camera: x right, y down, z forward.
function orbitPose({target, distance, around, above}) {
  const back = [Math.cos(above) * Math.cos(around), Math.cos(above) * Math.sin(around), Math.sin(above)];
  const z = back.map(value => -value), x = [-Math.sin(around), Math.cos(around), 0], y = cross(z, x);
  const eye = target.map((value, i) => value + distance * back[i]);
  return [x, y, z].flatMap(row => [...row, -dot(row, eye)]).concat([0, 0, 0, 1]);
}

// What an image of that camera shows, whole, in the middle of a canvas of `aspect`.
function projection(camera, aspect, near, far) {
  const own = camera.width / camera.height, sx = Math.min(1, own / aspect), sy = Math.min(1, aspect / own);
  return [
    2 * camera.fx / camera.width * sx, 0, ((2 * camera.cx + 1) / camera.width - 1) * sx, 0,
    0, -2 * camera.fy / camera.height * sy, (1 - (2 * camera.cy + 1) / camera.height) * sy, 0,
    0, 0, (far + near) / (far - near), -2 * far * near / (far - near),
    0, 0, 1, 0,
  ];
}

// The middle of what is of interest, and how far it reaches.
function extent(scene, poses, points) {
  const places = poses.length ? poses.map(pose => [pose[3], pose[7], pose[11]]) : rows(points, 3);
  const middle = [0, 1, 2].map(k => places.reduce((sum, place) => sum + place[k], 0) / Math.max(1, places.length));
  const reach = places.reduce((most, place) => Math.max(most, distance(place, middle)), 1e-3);
  const box = scene.bin ? Math.hypot(scene.bin.width, scene.bin.depth) / 2 : 0;
  return {middle, radius: Math.max(1.3 * reach, box)};
}

function show(canvas) {
  const scene = JSON.parse(canvas.nextElementSibling.textContent);
  const gl = canvas.getContext("webgl2", {antialias: true});
  if (!gl) {
    canvas.replaceWith("This browser has no WebGL 2, which the 3D view needs.");
    return;
  }
  const poses = rows(floats(scene.world_from_mesh), 16), views = rows(floats(scene.cam_from_world), 16);
  const colors = rows(floats(scene.colors), 3), points = floats(scene.points), used = program(gl);
  const {middle, radius} = extent(scene, poses, points);
  const mesh = shape(gl, gl.TRIANGLES, floats(scene.vertices), null, new Uint32Array(bytes(scene.faces).buffer));
  const cloud = shape(gl, gl.POINTS, points, floats(scene.point_colors));
  const bin = shape(gl, gl.LINES, scene.bin ? binLines(scene.bin) : new Float32Array(0), null);
  const cameras = shape(gl, gl.LINES, frustumLines(views, scene.camera, 0.25 * radius), null);
  const unmoved = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  const eye = {width: 1, height: 1, fx: 1.4, fy: 1.4, cx: 0, cy: 0};  // pixel centers: the middle of a 1 x 1 image
  const start = () => ({target: [...middle], distance: 2.8 * radius, around: -1.0, above: 0.75});
  const found = [...canvas.parentElement.querySelectorAll("[data-show]")];
  const controls = Object.fromEntries(found.map(control => [control.dataset.show, control]));
  let orbit = start();

  const set = (name, matrix) => gl.uniformMatrix4fv(gl.getUniformLocation(used, name), true, new Float32Array(matrix));
  const lit = on => gl.uniform1i(gl.getUniformLocation(used, "lit"), on);

  function draw() {
    const scale = window.devicePixelRatio || 1, from = Number(controls.from.value);
    canvas.width = Math.round(canvas.clientWidth * scale);
    canvas.height = Math.round(canvas.clientHeight * scale);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.09, 0.11, 0.13, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(used);
    const pose = from < 0 ? orbitPose(orbit) : [...views[from]];
    const away = distance(inWorld(pose, [0, 0, 0]), middle);
    const camera = from < 0 ? eye : scene.camera, aspect = canvas.width / canvas.height;
    set("clip_from_cam", projection(camera, aspect, 0.01 * radius, away + 20 * radius));
    set("cam_from_world", pose);
    set("world_from_mesh", unmoved);
    lit(false);
    if (controls.points.checked) cloud();
    if (controls.bin.checked) bin([0.75, 0.78, 0.82]);
    if (controls.cameras.checked) cameras([1, 0.75, 0.3]);
    lit(true);
    if (controls.mesh.checked) {
      poses.forEach((place, i) => {
        set("world_from_mesh", place);
        mesh(colors[i]);
      });
    }
    canvas.dataset.drawn = gl.getError() === gl.NO_ERROR ? poses.length : "failed";
  }

  const change = action => { controls.from.value = "-1"; action(); draw(); };
  const nearer = factor => change(() => {
    orbit.distance = Math.min(Math.max(orbit.distance * factor, 0.1 * radius), 20 * radius);
  });
  const turn = (x, y) => change(() => {
    orbit.around -= 0.008 * x;
    orbit.above = Math.min(Math.max(orbit.above + 0.008 * y, -1.5), 1.5);
  });
  const move = (x, y) => change(() => {
    const pose = orbitPose(orbit), step = orbit.distance / (1.4 * Math.min(canvas.clientWidth, canvas.clientHeight));
    orbit.target = orbit.target.map((value, k) => value - step * (x * pose[k] + y * pose[4 + k]));
  });
  canvas.addEventListener("pointerdown", event => { canvas.setPointerCapture(event.pointerId); canvas.focus(); });
  canvas.addEventListener("pointermove", event => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    (event.shiftKey || event.buttons > 1 ? move : turn)(event.movementX, event.movementY);
  });
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("wheel", event => {
    if (document.activeElement !== canvas) return;  // or nobody could scroll past it
    event.preventDefault();
    nearer(Math.exp(0.001 * event.deltaY));
  }, {passive: false});
  canvas.addEventListener("keydown", event => {
    const known = {ArrowLeft: () => turn(-10, 0), ArrowRight: () => turn(10, 0), ArrowUp: () => turn(0, 10),
      ArrowDown: () => turn(0, -10), "+": () => nearer(0.9), "-": () => nearer(1.1)};
    if (!(event.key in known)) return;
    event.preventDefault();
    known[event.key]();
  });
  canvas.addEventListener("dblclick", () => change(() => { orbit = start(); }));
  Object.values(controls).forEach(control => control.addEventListener("change", draw));
  new ResizeObserver(draw).observe(canvas);
  draw();
}

document.querySelectorAll("canvas.scene").forEach(show);
