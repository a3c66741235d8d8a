// 3D views of recorded poses, side by side. It needs the global THREE of three.min.js.
//
// Pages in a folder load neither modules nor JSON. So the data of each view are a script that hands them to `gaugeMotionView`.
"use strict";

(function () {
  const FRAME_S = 1 / 30;
  const up = new THREE.Vector3(0, 1, 0), start = new THREE.Vector3(), end = new THREE.Vector3();
  const rotation = new THREE.Quaternion();
  const waiting = {};

  window.gaugeMotionView = (key, data) => waiting[key](data);

  // --- data ---

  function load(entry) {
    return new Promise((resolve, reject) => {
      waiting[entry.key] = resolve;
      const script = document.createElement("script");
      script.src = `data/${entry.key}.js`;
      script.onerror = () => reject(new Error(script.src + " is missing"));
      document.head.append(script);
    });
  }

  function integers(text, Type = Int16Array) {
    return new Type(Uint8Array.from(atob(text), (character) => character.charCodeAt(0)).buffer);
  }

  function numbers(packed) {
    return Float32Array.from(integers(packed.data), (count) => count * packed.step);
  }

  // Return a function that gives the `width` numbers of a view between view `index` and the next one.
  function views(values, width) {
    const now = new Float32Array(width), last = values.length / width - 1;
    return (view) => {
      const index = Math.min(Math.floor(view), last), share = Math.min(view, last) - index;
      const first = index * width, next = Math.min(index + 1, last) * width;
      for (let i = 0; i < width; i++) now[i] = values[first + i] * (1 - share) + values[next + i] * share;
      return now;
    };
  }

  function color(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  }

  // --- still parts ---

  function geometryOf(solid) {
    switch (solid.kind) {
      case "box": return new THREE.BoxGeometry(...solid.size_m);
      case "sphere": return new THREE.SphereGeometry(solid.radius_m, 32, 20);
      case "ellipsoid": return new THREE.SphereGeometry(1, 32, 20).scale(...solid.radii_m);
      // three.js has the axis along y, the scenes along z.
      case "cylinder": return new THREE.CylinderGeometry(solid.radius_m, solid.radius_m, solid.length_m, 48).rotateX(Math.PI / 2);
      case "capsule": return new THREE.CapsuleGeometry(solid.radius_m, solid.length_m).rotateX(Math.PI / 2);
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(solid.triangles, 3));
    geometry.computeVertexNormals();
    return geometry;
  }

  function place(object, pose) {
    object.position.fromArray(pose);
    object.quaternion.fromArray(pose, 3);
  }

  function ground(camera) {
    const width = 400 * camera.distance_m; // Beyond the far plane, so that the horizon is level.
    const material = new THREE.MeshBasicMaterial({ color: color("--floor") });
    const step = camera.distance_m < 3 ? 0.1 : 0.5;
    const count = 2 * Math.ceil((1.5 * camera.distance_m) / step);
    const grid = new THREE.GridHelper(count * step, count, color("--head"), color("--head"));
    grid.rotation.x = Math.PI / 2;
    grid.position.set(Math.round(camera.target_m[0]), Math.round(camera.target_m[1]), 5e-4 * camera.distance_m);
    return new THREE.Group().add(new THREE.Mesh(new THREE.PlaneGeometry(width, width), material), grid);
  }

  function bodyOf(body, solids) {
    const group = new THREE.Group();
    // The faces lie a little deeper than their edges, or both flicker.
    const deeper = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };
    const material = new THREE.MeshLambertMaterial({ color: body.color, ...deeper });
    for (const solid of solids) {
      const mesh = new THREE.Mesh(geometryOf(solid), material);
      if (solid.kind === "box" || solid.triangles) {
        // Edges show how a body turns, and where bricks touch.
        const edges = new THREE.EdgesGeometry(mesh.geometry, 20);
        mesh.add(new THREE.LineSegments(edges, new THREE.LineBasicMaterial({ color: 0x40362c })));
      }
      place(mesh, solid.pose);
      group.add(mesh);
    }
    return group;
  }

  // --- moving parts: each function returns one that moves its parts to a view, as 2.5 between views 2 and 3 ---

  function movingBodies(data, bodies) {
    const places = views(numbers(data.positions), 3 * data.moving.length);
    const turns = numbers(data.turns), count = data.moving.length;
    return (view) => {
      const now = places(view), index = Math.floor(view), next = Math.min(index + 1, data.views - 1);
      data.moving.forEach((name, body) => {
        const object = bodies[name];
        object.position.fromArray(now, 3 * body);
        object.quaternion.fromArray(turns, 4 * (index * count + body)).normalize();
        rotation.fromArray(turns, 4 * (next * count + body)).normalize();
        object.quaternion.slerp(rotation, view - index);
      });
    };
  }

  // Cylinders from point to point.
  function segments(scene, count, radius, color) {
    const geometry = new THREE.CylinderGeometry(radius, radius, 1, 10);
    const material = new THREE.MeshLambertMaterial({ color });
    const meshes = Array.from({ length: count }, () => new THREE.Mesh(geometry, material));
    scene.add(...meshes);
    return (index, from, to) => {
      const mesh = meshes[index], length = Math.max(from.distanceTo(to), 1e-9);
      mesh.position.addVectors(from, to).multiplyScalar(0.5);
      mesh.scale.y = length;
      mesh.quaternion.setFromUnitVectors(up, to.sub(from).divideScalar(length));
    };
  }

  function strings(data, scene, bodies) {
    const span = segments(scene, data.scene.strings.length, data.scene.string.radius, color("--real"));
    return () =>
      data.scene.strings.forEach((string, index) =>
        span(index, start.fromArray(string.anchor), end.copy(bodies[string.body].position))
      );
  }

  function softBody(soft, scene) {
    const nodes = views(numbers(soft.nodes), 3 * soft.count);
    if (soft.kind === "line") {
      const span = segments(scene, soft.count - 1, soft.radius, soft.color);
      return (view) => {
        const now = nodes(view);
        for (let i = 0; i + 1 < soft.count; i++) span(i, start.fromArray(now, 3 * i), end.fromArray(now, 3 * i + 3));
      };
    }
    const geometry = new THREE.BufferGeometry();
    const attribute = new THREE.BufferAttribute(new Float32Array(3 * soft.count), 3);
    geometry.setAttribute("position", attribute);
    geometry.setIndex(new THREE.BufferAttribute(integers(soft.faces, Uint16Array), 1));
    const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: soft.color, side: THREE.DoubleSide }));
    mesh.frustumCulled = false;
    scene.add(mesh);
    return (view) => {
      attribute.array.set(nodes(view));
      attribute.needsUpdate = true;
      geometry.computeVertexNormals();
    };
  }

  function dots(scene, count, color, size) {
    const attribute = new THREE.BufferAttribute(new Float32Array(3 * count), 3);
    const geometry = new THREE.BufferGeometry().setAttribute("position", attribute);
    const material = new THREE.PointsMaterial({ color, size, sizeAttenuation: false, depthTest: false });
    const drawn = new THREE.Points(geometry, material);
    drawn.frustumCulled = false;
    drawn.renderOrder = 2;
    scene.add(drawn);
    return attribute;
  }

  function markers(data, scene) {
    const places = views(numbers(data.markers), 3 * data.markers.count);
    const attribute = dots(scene, data.markers.count, 0x202020, 6);
    return (view) => {
      attribute.array.set(places(view / data.rate / FRAME_S));
      attribute.needsUpdate = true;
    };
  }

  // The reference: a path over all frames, and a translucent ball, or a dot, where it is now.
  function ghost(data, group) {
    const real = data.ghost, tint = color("--real");
    const line = new THREE.LineBasicMaterial({ color: tint, transparent: true, opacity: 0.8, depthTest: false });
    // Nearer by 0.3 % of the distance, or it flickers on the simulated ball.
    const nearer = { polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -1000 };
    const solid = new THREE.MeshLambertMaterial({ color: tint, transparent: true, opacity: 0.4, depthWrite: false, ...nearer });
    const movers = real.radii.map((radius, point) => {
      const path = real.places.filter(Boolean).map((places) => new THREE.Vector3(...places[point]));
      group.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints(path), line));
      if (radius) {
        const ball = new THREE.Mesh(new THREE.SphereGeometry(radius, 32, 20), solid);
        group.add(ball);
        return (place) => ball.position.copy(place);
      }
      const attribute = dots(group, 1, tint, 12);
      return (place) => {
        place.toArray(attribute.array);
        attribute.needsUpdate = true;
      };
    });
    return (view) => {
      const frame = Math.min(view / data.rate / FRAME_S, real.places.length - 1), index = Math.floor(frame);
      const now = real.places[index], next = real.places[Math.min(index + 1, real.places.length - 1)] || now;
      if (now) movers.forEach((move, point) => move(start.fromArray(now[point]).lerp(end.fromArray(next[point]), frame % 1)));
    };
  }

  function build(data) {
    const scene = new THREE.Scene(), reference = new THREE.Group(), bodies = {};
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(-0.4, -1, 2.5);
    scene.add(new THREE.HemisphereLight(0xffffff, 0xb8bcc4, 2.8), sun, reference);
    for (const body of data.scene.bodies) {
      const solids = data.scene.shapes[body.shape];
      bodies[body.name] = solids[0].kind === "plane" ? ground(data.scene.camera) : bodyOf(body, solids);
      place(bodies[body.name], body.pose);
      scene.add(bodies[body.name]);
    }
    const moves = [movingBodies(data, bodies), ...data.soft.map((soft) => softBody(soft, scene))];
    if (data.scene.strings.length) moves.push(strings(data, scene, bodies));
    if (data.markers.count) moves.push(markers(data, scene));
    if (data.ghost) moves.push(ghost(data, reference));
    const last = data.views - 1;
    return {
      scene, reference,
      end: last / data.rate,
      show: (time) => moves.forEach((move) => move(Math.min(time * data.rate, last))),
    };
  }

  // --- page ---

  function begin(root) {
    const entries = JSON.parse(root.dataset.views);
    const stage = root.querySelector(".stage");
    const part = (name) => root.querySelector(`[name=${name}]`);
    const [button, slider, speed, output, reset, ghosts] = ["play", "time", "speed", "now", "view", "ghost"].map(part);
    const boxes = entries.map((entry) => {
      const label = document.createElement("label"), box = document.createElement("input");
      box.type = "checkbox";
      label.append(box, " " + entry.label);
      ghosts.parentElement.before(label);
      return box;
    });
    let renderer;
    try {
      renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    } catch (error) {
      root.replaceChildren("This browser has no WebGL, so there is no 3D view. The curves show the same motion.");
      return;
    }
    const camera = new THREE.PerspectiveCamera();
    camera.up.set(0, 0, 1);
    const orbit = new THREE.OrbitControls(camera, stage);
    stage.style.touchAction = "pan-y"; // A vertical swipe scrolls the page.
    orbit.enableZoom = false; // Until the pictures have the focus, the wheel scrolls the page.
    let shown = [], time = 0, last = 0, playing = false, before = 0, home = null, pending = false;

    // One renderer draws all pictures: a browser allows few.
    function draw() {
      pending = false;
      for (const entry of shown) {
        const canvas = entry.canvas;
        const width = canvas.clientWidth * devicePixelRatio, height = canvas.clientHeight * devicePixelRatio;
        if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
        renderer.setSize(width, height, false);
        camera.aspect = width / height;
        camera.updateProjectionMatrix();
        entry.built.reference.visible = ghosts.checked;
        entry.built.show(time);
        renderer.render(entry.built.scene, camera);
        const context = canvas.getContext("2d");
        context.clearRect(0, 0, width, height);
        context.drawImage(renderer.domElement, 0, 0);
      }
      slider.value = time;
      output.value = `${time.toFixed(2)} of ${last.toFixed(2)} s`;
      slider.setAttribute("aria-valuetext", output.value);
    }

    function redraw() {
      if (!pending) requestAnimationFrame(draw);
      pending = true;
    }

    function look() {
      const azimuth = (home.azimuth_deg * Math.PI) / 180, elevation = (home.elevation_deg * Math.PI) / 180;
      const flat = Math.cos(elevation), { clientWidth, clientHeight } = shown[0].canvas;
      // A narrow picture needs more distance to show the same width.
      const distance = (0.9 * home.distance_m) / Math.min(1, clientWidth / clientHeight);
      orbit.target.fromArray(home.target_m);
      start.set(flat * Math.cos(azimuth), flat * Math.sin(azimuth), Math.sin(elevation));
      camera.position.copy(orbit.target).addScaledVector(start, -distance);
      Object.assign(camera, { fov: home.fov_deg, near: 0.02 * distance, far: 80 * distance });
      orbit.update();
      redraw();
    }

    function figure(entry) {
      const picture = document.createElement("figure"), caption = document.createElement("figcaption");
      entry.canvas = document.createElement("canvas");
      caption.style.borderColor = entry.color;
      caption.textContent = entry.label;
      picture.append(caption, entry.canvas);
      return picture;
    }

    async function choose() {
      const chosen = entries.filter((_, index) => boxes[index].checked);
      for (const entry of chosen) {
        if (entry.built) continue;
        const data = await load(entry);
        home ??= data.scene.camera;
        entry.built = build(data);
        entry.figure = figure(entry);
      }
      shown = chosen;
      last = Math.max(0, ...shown.map((entry) => entry.built.end));
      const isFirst = !stage.firstChild;
      stage.replaceChildren(...shown.map((entry) => entry.figure));
      slider.max = last;
      time = Math.min(time, last);
      if (isFirst && shown.length) look();
      ghosts.parentElement.hidden = !shown.some((entry) => entry.built.reference.children.length);
      draw();
    }

    function tick(now) {
      if (!playing) return;
      time += ((now - before) / 1000) * Number(speed.value);
      before = now;
      if (time > last) time = 0;
      draw();
      requestAnimationFrame(tick);
    }

    function play() {
      playing = !playing;
      button.textContent = playing ? "Pause" : "Play";
      before = performance.now();
      if (playing) requestAnimationFrame(tick);
    }

    function seek() {
      time = Number(slider.value);
      redraw();
    }

    const fail = (error) => root.replaceChildren("The 3D view cannot be shown: " + error.message + ".");
    for (const box of boxes) box.addEventListener("change", () => choose().catch(fail));
    ghosts.addEventListener("change", redraw);
    button.addEventListener("click", play);
    slider.addEventListener("input", seek);
    reset.addEventListener("click", look);
    orbit.addEventListener("change", redraw);
    stage.addEventListener("pointerdown", () => stage.focus({ preventScroll: true }));
    stage.addEventListener("focus", () => (orbit.enableZoom = true));
    stage.addEventListener("blur", () => (orbit.enableZoom = false));
    new ResizeObserver(redraw).observe(stage);
    boxes.slice(0, 3).forEach((box) => (box.checked = true));
    choose().catch(fail);
  }

  for (const root of document.querySelectorAll(".motion-view")) begin(root);
})();
