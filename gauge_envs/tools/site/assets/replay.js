// 3D replays of recorded poses, side by side. It needs the global THREE of three.min.js.
//
// The pages open from a folder, where browsers load neither modules nor JSON. So this is a classic script, and each
// replay is a script of its own, which hands its data to `gaugeReplay`.
"use strict";

(function () {
  const MOST = 32767; // Largest component of a stored quaternion.
  const STRIP = 28; // Height of the names above the pictures [px].
  const CROWD = 20; // Most bodies of one shape that are drawn one by one, with their edges.
  const waiting = {};

  window.gaugeReplay = (key, data) => waiting[key](data);

  function load(entry) {
    entry.data ??= new Promise((resolve, reject) => {
      waiting[entry.key] = (data) => resolve(data);
      const script = document.createElement("script");
      script.src = entry.file;
      script.onerror = () => reject(new Error(entry.file + " is missing"));
      document.head.append(script);
    });
    return entry.data;
  }

  function css(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  }

  function numbers(text, Type) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Type(bytes.buffer);
  }

  function points(packed) {
    const counts = numbers(packed.data, Int16Array);
    const values = new Float32Array(counts.length);
    for (let i = 0; i < counts.length; i++) values[i] = packed.centre[i % 3] + counts[i] * packed.step[i % 3];
    return values;
  }

  // Dots have a size in pixels. A small picture has small dots.
  let dotScale = 1;

  // --- still parts ---

  function geometryOf(solid) {
    if (solid.kind === "box") return new THREE.BoxGeometry(...solid.size);
    if (solid.kind === "sphere") return new THREE.SphereGeometry(solid.radius, 32, 20);
    if (solid.kind === "ellipsoid") return new THREE.SphereGeometry(1, 32, 20).scale(...solid.radii);
    // three.js has the axis along y, the scenes along z.
    if (solid.kind === "cylinder")
      return new THREE.CylinderGeometry(solid.radius, solid.radius, solid.length, 48).rotateX(Math.PI / 2);
    if (solid.kind === "capsule") return new THREE.CapsuleGeometry(solid.radius, solid.length).rotateX(Math.PI / 2);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(solid.triangles, 3));
    geometry.computeVertexNormals();
    return geometry;
  }

  function place(object, pose, first = 0) {
    object.position.fromArray(pose, first);
    object.quaternion.fromArray(pose, first + 3);
  }

  function ground(camera) {
    const wide = 400 * camera.distance; // Beyond the far plane, so that the horizon is level.
    const group = new THREE.Group();
    const floor = new THREE.Mesh(new THREE.PlaneGeometry(wide, wide), new THREE.MeshBasicMaterial());
    const step = camera.distance < 3 ? 0.1 : 0.5;
    const lines = 2 * Math.ceil((1.5 * camera.distance) / step);
    const grid = new THREE.GridHelper(lines * step, lines);
    grid.rotation.x = Math.PI / 2;
    grid.position.z = 5e-4 * camera.distance; // Above the floor, or both flicker.
    group.add(floor, grid);
    group.userData.paint = () => {
      floor.material.color.set(css("--floor"));
      grid.material.vertexColors = false;
      grid.material.color.set(css("--head"));
    };
    return group;
  }

  function bodyOf(body, shapes) {
    const group = new THREE.Group();
    // The faces lie a little deeper than their edges, or both flicker.
    const deeper = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };
    const material = new THREE.MeshLambertMaterial({ color: body.color, ...deeper });
    for (const solid of shapes[body.shape]) {
      const mesh = new THREE.Mesh(geometryOf(solid), material);
      if (solid.kind === "box" || solid.kind === "mesh") {
        // Edges show how a body turns, and where bricks touch.
        const edges = new THREE.EdgesGeometry(mesh.geometry, 20);
        mesh.add(new THREE.LineSegments(edges, new THREE.LineBasicMaterial({ color: 0x40362c })));
      }
      if (solid.pose) place(mesh, solid.pose);
      group.add(mesh);
    }
    return group;
  }

  // Equal bodies, as the bricks of a wall: one drawing for all, in shades, because it has no edges.
  function crowd(members, solid, scene) {
    const mesh = new THREE.InstancedMesh(geometryOf(solid), new THREE.MeshLambertMaterial(), members.length);
    mesh.frustumCulled = false;
    const shade = new THREE.Color();
    members.forEach(({ body }, index) => {
      shade.set(body.color).offsetHSL(0, 0, 0.03 * ((index * 7) % 5) - 0.06);
      mesh.setColorAt(index, shade);
    });
    scene.add(mesh);
    return () => {
      members.forEach(({ object }, index) => {
        matrix.compose(object.position, object.quaternion, size.set(1, 1, 1));
        mesh.setMatrixAt(index, matrix);
      });
      mesh.instanceMatrix.needsUpdate = true;
    };
  }

  // --- moving parts ---

  const up = new THREE.Vector3(0, 1, 0), one = new THREE.Vector3(), two = new THREE.Vector3();
  const turn = new THREE.Quaternion(), other = new THREE.Quaternion(), size = new THREE.Vector3();
  const matrix = new THREE.Matrix4();

  function segments(count, radius, color) {
    const geometry = new THREE.CylinderGeometry(radius, radius, 1, 10);
    const mesh = new THREE.InstancedMesh(geometry, new THREE.MeshLambertMaterial({ color }), count);
    mesh.frustumCulled = false;
    mesh.userData.span = (index, start, end) => {
      const along = end.clone().sub(start);
      const length = Math.max(along.length(), 1e-9);
      turn.setFromUnitVectors(up, along.divideScalar(length));
      matrix.compose(start.clone().add(end).multiplyScalar(0.5), turn, size.set(1, length, 1));
      mesh.setMatrixAt(index, matrix);
      mesh.instanceMatrix.needsUpdate = true;
    };
    return mesh;
  }

  // Each of these returns a function that moves its parts to view `index + share`.

  function movingBodies(data, scene, bodies) {
    const places = points(data.positions), turns = numbers(data.turns, Int16Array);
    const count = data.moving.length, last = data.views - 1;
    return (index, share) => {
      const next = Math.min(index + 1, last);
      data.moving.forEach((name, body) => {
        const at = index * count + body, then = next * count + body, object = bodies[name];
        object.position.fromArray(places, 3 * at).lerp(one.fromArray(places, 3 * then), share);
        turn.fromArray(turns, 4 * at).normalize();
        object.quaternion.copy(turn).slerp(other.fromArray(turns, 4 * then).normalize(), share);
      });
    };
  }

  function strings(data, scene, bodies) {
    const drawn = segments(data.scene.strings.length, data.scene.string.radius, 0);
    drawn.userData.paint = () => drawn.material.color.set(css("--real"));
    drawn.userData.move = () =>
      data.scene.strings.forEach((string, index) =>
        drawn.userData.span(index, one.fromArray(string.anchor), two.copy(bodies[string.body].position))
      );
    scene.add(drawn);
    return drawn;
  }

  function between(values, stride, last) {
    const now = new Float32Array(stride);
    return (index, share) => {
      const a = index * stride, b = Math.min(index + 1, last) * stride;
      for (let i = 0; i < stride; i++) now[i] = values[a + i] + share * (values[b + i] - values[a + i]);
      return now;
    };
  }

  function softBody(soft, scene, last) {
    const read = between(points(soft.nodes), 3 * soft.count, last);
    if (soft.kind === "line") {
      const drawn = segments(soft.count - 1, soft.radius, soft.color);
      scene.add(drawn);
      return (index, share) => {
        const now = read(index, share);
        for (let i = 0; i + 1 < soft.count; i++)
          drawn.userData.span(i, one.fromArray(now, 3 * i), two.fromArray(now, 3 * i + 3));
      };
    }
    const geometry = new THREE.BufferGeometry();
    const attribute = new THREE.BufferAttribute(new Float32Array(3 * soft.count), 3);
    geometry.setAttribute("position", attribute);
    geometry.setIndex(new THREE.BufferAttribute(numbers(soft.faces, Uint16Array), 1));
    const material = new THREE.MeshLambertMaterial({ color: soft.color, side: THREE.DoubleSide });
    const mesh = new THREE.Mesh(geometry, material);
    mesh.frustumCulled = false;
    scene.add(mesh);
    return (index, share) => {
      attribute.array.set(read(index, share));
      attribute.needsUpdate = true;
      geometry.computeVertexNormals();
    };
  }

  function dots(count, color, pixels) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * count), 3));
    const material = new THREE.PointsMaterial({ color, size: pixels, sizeAttenuation: false, depthTest: false });
    const drawn = new THREE.Points(geometry, material);
    drawn.frustumCulled = false;
    drawn.renderOrder = 2;
    drawn.onBeforeRender = () => (material.size = pixels * dotScale * Math.min(devicePixelRatio, 2));
    return drawn;
  }

  function markers(data, scene) {
    const drawn = dots(data.markers.count, 0x202020, 4);
    const last = data.markers.data.length ? points(data.markers).length / (3 * data.markers.count) - 1 : 0;
    const read = between(points(data.markers), 3 * data.markers.count, last);
    scene.add(drawn);
    return (index, share) => {
      const frame = Math.min(((index + share) * 30) / data.rate, last);
      drawn.geometry.attributes.position.array.set(read(Math.floor(frame), frame % 1));
      drawn.geometry.attributes.position.needsUpdate = true;
    };
  }

  // The real trajectory: a path over all frames, and a translucent ball, or a dot, where it is now.
  function ghost(data, scene) {
    const group = new THREE.Group(), real = data.ghost;
    const line = new THREE.LineBasicMaterial({ transparent: true, opacity: 0.8, depthTest: false });
    // Nearer than it is by 0.3 % of the distance, or it flickers where it coincides with the simulated ball.
    const nearer = { polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -1000 };
    const solid = new THREE.MeshLambertMaterial({ transparent: true, opacity: 0.4, depthWrite: false, ...nearer });
    const balls = real.radii.map((radius) => radius && new THREE.Mesh(new THREE.SphereGeometry(radius, 32, 20), solid));
    const bare = real.names.map((_, body) => body).filter((body) => !balls[body]);
    const dot = dots(Math.max(bare.length, 1), 0, 9);
    real.names.forEach((_, body) => {
      const known = real.places.filter(Boolean).map((row) => new THREE.Vector3(...row[body]));
      const path = new THREE.Line(new THREE.BufferGeometry().setFromPoints(known), line);
      path.renderOrder = 1;
      group.add(path);
      if (balls[body]) group.add(balls[body]);
    });
    if (bare.length) group.add(dot);
    scene.add(group);
    group.userData.paint = () => [line, solid, dot.material].forEach((m) => m.color.set(css("--real")));
    group.userData.move = (index, share) => {
      const frame = Math.min(((index + share) * 30) / data.rate, real.places.length - 1);
      const first = Math.floor(frame), a = real.places[first], b = real.places[Math.min(first + 1, real.places.length - 1)];
      dot.visible = Boolean(a);
      balls.forEach((ball) => ball && (ball.visible = Boolean(a)));
      if (!a) return;
      real.names.forEach((_, body) => {
        one.fromArray(a[body]).lerp(two.fromArray((b || a)[body]), frame % 1);
        if (balls[body]) balls[body].position.copy(one);
        else one.toArray(dot.geometry.attributes.position.array, 3 * bare.indexOf(body));
      });
      dot.geometry.attributes.position.needsUpdate = true;
    };
    return group;
  }

  function build(data) {
    const scene = new THREE.Scene(), bodies = {}, painted = [];
    scene.add(new THREE.HemisphereLight(0xffffff, 0xb8bcc4, 2.8));
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(-0.4, -1, 2.5);
    scene.add(sun);
    const crowds = {}, alike = {};
    for (const body of data.scene.bodies) alike[body.shape] = (alike[body.shape] ?? 0) + 1;
    for (const body of data.scene.bodies) {
      const solids = data.scene.shapes[body.shape], isPlane = solids[0].kind === "plane";
      if (!isPlane && solids.length === 1 && !solids[0].pose && alike[body.shape] > CROWD) {
        const object = new THREE.Group();
        place(object, body.pose);
        bodies[body.name] = object;
        (crowds[body.shape] ??= []).push({ body, object });
        continue;
      }
      const object = isPlane ? ground(data.scene.camera) : bodyOf(body, data.scene.shapes);
      place(object, body.pose);
      if (isPlane) {
        object.position.x += Math.round(data.scene.camera.target[0]);
        object.position.y += Math.round(data.scene.camera.target[1]);
        painted.push(object);
      }
      bodies[body.name] = object;
      scene.add(object);
    }
    const moves = [movingBodies(data, scene, bodies)];
    for (const shape in crowds) moves.push(crowd(crowds[shape], data.scene.shapes[shape][0], scene));
    if (data.scene.strings.length) {
      const drawn = strings(data, scene, bodies);
      painted.push(drawn);
      moves.push(drawn.userData.move);
    }
    for (const soft of data.soft) moves.push(softBody(soft, scene, data.views - 1));
    if (data.markers) moves.push(markers(data, scene));
    const real = data.ghost && ghost(data, scene);
    if (real) {
      painted.push(real);
      moves.push(real.userData.move);
    }
    const paint = () => painted.forEach((object) => object.userData.paint());
    paint();
    return {
      scene, paint, real,
      end: (data.views - 1) / data.rate,
      show(time) {
        const view = Math.min(time * data.rate, data.views - 1);
        moves.forEach((move) => move(Math.floor(view), view % 1));
      },
    };
  }

  // --- page ---

  function start(root) {
    const entries = JSON.parse(root.dataset.replays);
    const stage = root.querySelector(".stage"), controls = root.querySelector(".controls");
    const canvas = stage.querySelector("canvas"), names = stage.querySelector(".names");
    const part = (name) => controls.querySelector(`[name=${name}]`);
    const [button, slider, speed, output, reset] = ["play", "time", "speed", "now", "view"].map(part);
    const boxes = [...controls.querySelectorAll("[name=engine]")], ghosts = part("ghost");
    let renderer;
    try {
      renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    } catch (error) {
      root.replaceChildren("This browser has no WebGL, so there is no replay. The curves show the same motion.");
      return;
    }
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    const camera = new THREE.PerspectiveCamera();
    camera.up.set(0, 0, 1);
    const orbit = new THREE.OrbitControls(camera, canvas);
    canvas.style.touchAction = "pan-y"; // A vertical swipe scrolls the page.
    orbit.enableZoom = false; // Until the picture has the focus, the wheel scrolls the page.
    let shown = [], time = 0, end = 0, playing = false, before = 0, home = null, looked = false, pending = false;
    let drawnSize = "";

    function layout() {
      const width = stage.clientWidth, count = Math.max(shown.length, 1);
      const columns = Math.min(count, width < 700 ? 2 : count === 4 ? 2 : 3);
      const cell = Math.floor(width / columns), rows = Math.ceil(count / columns);
      const height = Math.round(Math.min(cell * (count === 1 ? 0.56 : 0.75), 520)) + STRIP;
      // A new size, even an equal one, makes the browser allocate the picture anew.
      if (drawnSize !== `${width} ${rows * height}`) {
        drawnSize = `${width} ${rows * height}`;
        renderer.setSize(width, rows * height, false);
        canvas.style.height = rows * height + "px";
      }
      return { columns, cell, height, rows, picture: height - STRIP };
    }

    function draw() {
      pending = false;
      const { columns, cell, height, rows, picture } = layout();
      camera.aspect = cell / picture;
      camera.updateProjectionMatrix();
      renderer.setScissorTest(true);
      dotScale = Math.min(1, cell / 500);
      shown.forEach((one, index) => {
        const x = (index % columns) * cell, y = (rows - 1 - Math.floor(index / columns)) * height;
        renderer.setViewport(x, y, cell - 2, picture - 2);
        renderer.setScissor(x, y, cell - 2, picture - 2);
        if (one.built.real) one.built.real.visible = !ghosts || ghosts.checked;
        one.built.show(time);
        renderer.render(one.built.scene, camera);
      });
      slider.value = time;
      const text = `${time.toFixed(2)} of ${end.toFixed(2)} s`;
      output.value = text;
      slider.setAttribute("aria-valuetext", text);
    }

    function redraw() {
      if (!pending && !playing) requestAnimationFrame(draw);
      pending = !playing;
    }

    function look() {
      const view = home.camera, azimuth = (view.azimuth * Math.PI) / 180, elevation = (view.elevation * Math.PI) / 180;
      orbit.target.fromArray(view.target);
      // A narrow picture needs more distance to show the same width.
      const { cell, picture } = layout(), distance = (0.9 * view.distance) / Math.min(1, cell / picture);
      const flat = Math.cos(elevation);
      one.set(flat * Math.cos(azimuth), flat * Math.sin(azimuth), Math.sin(elevation));
      camera.position.copy(orbit.target).addScaledVector(one, -distance);
      camera.fov = view.fov;
      camera.near = 0.02 * distance;
      camera.far = 80 * distance;
      orbit.update();
      redraw();
    }

    function label() {
      const { columns, cell, height } = layout();
      names.replaceChildren(
        ...shown.map((one, index) => {
          const text = document.createElement("span");
          text.textContent = one.label + (one.built.end < end - 0.02 ? `, ended at ${one.built.end.toFixed(2)} s` : "");
          text.style.cssText = `left:${(index % columns) * cell}px;top:${Math.floor(index / columns) * height}px;max-width:${cell - 12}px`;
          text.style.borderColor = one.color;
          return text;
        })
      );
    }

    async function choose() {
      const chosen = entries.filter((_, index) => boxes[index].checked);
      for (const entry of chosen) {
        const data = await load(entry);
        home ??= data.scene;
        entry.built ??= build(data);
      }
      shown = chosen;
      end = Math.max(0, ...shown.map((one) => one.built.end));
      slider.max = end;
      time = Math.min(time, end);
      label();
      if (shown.length && !looked) {
        looked = true;
        look();
      }
      redraw();
    }

    function tick(now) {
      if (!playing) return;
      // A tab that was hidden for long goes on where it was.
      time += Math.min((now - before) / 1000, 0.25) * Number(speed.value);
      before = now;
      if (time > end) time = end > 0 ? time % end : 0;
      draw();
      requestAnimationFrame(tick);
    }

    function play(wanted) {
      playing = wanted;
      button.textContent = playing ? "Pause" : "Play";
      before = performance.now();
      if (playing) requestAnimationFrame(tick);
    }

    function move(to) {
      time = Math.min(Math.max(to, 0), end);
      redraw();
    }

    button.addEventListener("click", () => play(!playing));
    slider.addEventListener("input", () => move(Number(slider.value)));
    reset.addEventListener("click", look);
    const fail = (error) => root.replaceChildren("The replay cannot be shown: " + error.message + ".");
    for (const box of boxes) box.addEventListener("change", () => choose().catch(fail));
    if (ghosts) ghosts.addEventListener("change", redraw);
    orbit.addEventListener("change", redraw);
    canvas.addEventListener("pointerdown", () => canvas.focus({ preventScroll: true }));
    canvas.addEventListener("focus", () => (orbit.enableZoom = true));
    canvas.addEventListener("blur", () => (orbit.enableZoom = false));
    canvas.addEventListener("keydown", (event) => {
      const step = event.shiftKey ? 1 / 6 : 1 / 30;
      const moves = { ArrowLeft: time - step, ArrowRight: time + step, Home: 0, End: end };
      const turns = { a: 0.15, d: -0.15 };
      if (event.key === " ") play(!playing);
      else if (event.key in moves) move(moves[event.key]);
      else if (event.key in turns) {
        one.copy(camera.position).sub(orbit.target).applyAxisAngle(camera.up, turns[event.key]);
        camera.position.copy(orbit.target).add(one);
        orbit.update();
      } else return;
      event.preventDefault();
    });
    // The height follows from the width, so a change of the height alone asks for nothing.
    let width = 0;
    const resized = () => {
      if (stage.clientWidth === width || !stage.isConnected) return;
      width = stage.clientWidth;
      label();
      redraw();
    };
    new ResizeObserver(() => requestAnimationFrame(resized)).observe(stage);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      for (const entry of entries) if (entry.built) entry.built.paint();
      redraw();
    });
    // A phone starts with two pictures, which share its width.
    const first = stage.clientWidth < 700 ? 2 : 6;
    boxes.forEach((box, index) => (box.checked = index < first));
    choose().catch(fail);
  }

  for (const root of document.querySelectorAll(".replay")) start(root);
})();
