{{- define "pretouch.name" -}}
{{- .Release.Name | trunc 40 | trimSuffix "-" -}}
{{- end }}

{{/* Labels that select the pods of a component: (dict "root" $ "component" NAME) */}}
{{- define "pretouch.selector" -}}
app.kubernetes.io/name: pretouch
app.kubernetes.io/instance: {{ .root.Release.Name }}
app.kubernetes.io/component: {{ .component }}
{{- end }}

{{- define "pretouch.labels" -}}
{{ include "pretouch.selector" . }}
app.kubernetes.io/version: {{ .root.Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .root.Release.Service }}
helm.sh/chart: {{ printf "%s-%s" .root.Chart.Name .root.Chart.Version }}
{{- end }}

{{/* The orchestrators' list of registrars. A fixed number is named one by one, so that a pod that moves keeps its scenes'
     place; a changing number is looked up. */}}
{{- define "pretouch.registrars" -}}
{{- $service := printf "%s-registrar" (include "pretouch.name" .) -}}
{{- if .Values.registrar.autoscaling.enabled -}}
dns:///{{ $service }}:50052
{{- else -}}
{{- $names := list -}}
{{- range until (int .Values.registrar.replicas) -}}
{{- $names = append $names (printf "%s-%d.%s:50052" $service . $service) -}}
{{- end -}}
{{ join "," $names }}
{{- end -}}
{{- end }}

{{/* What all pods have in common: (dict "root" $ "component" NAME "values" VALUES) */}}
{{- define "pretouch.pod" -}}
automountServiceAccountToken: false
enableServiceLinks: false
terminationGracePeriodSeconds: 45
securityContext:
  runAsNonRoot: true
  runAsUser: 10001
  runAsGroup: 10001
  fsGroup: 10001
  seccompProfile: {type: RuntimeDefault}
{{- with .root.Values.imagePullSecrets }}
imagePullSecrets: {{ toYaml . | nindent 2 }}
{{- end }}
{{- with merge (.values.nodeSelector | default dict) .root.Values.nodeSelector }}
nodeSelector: {{ toYaml . | nindent 2 }}
{{- end }}
{{- with .root.Values.tolerations }}
tolerations: {{ toYaml . | nindent 2 }}
{{- end }}
topologySpreadConstraints:
  - maxSkew: 1
    topologyKey: kubernetes.io/hostname
    whenUnsatisfiable: ScheduleAnyway
    labelSelector:
      matchLabels: {{ include "pretouch.selector" . | nindent 8 }}
volumes:
  - name: tmp
    emptyDir: {sizeLimit: 256Mi}
{{- end }}

{{/* What all containers have in common: (dict "root" $ "component" NAME "values" VALUES) */}}
{{- define "pretouch.container" -}}
name: {{ .component }}
image: {{ printf "%s%s:%s" .root.Values.image.prefix .component (.root.Values.image.tag | default .root.Chart.AppVersion) | quote }}
imagePullPolicy: {{ .root.Values.image.pullPolicy }}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
resources: {{ toYaml .values.resources | nindent 2 }}
volumeMounts:
  - {name: tmp, mountPath: /tmp}
# calls that were sent here before the other pods knew better still find it
lifecycle:
  preStop: {exec: {command: [sleep, "5"]}}
{{- end }}

{{- define "pretouch.env" -}}
- {name: PRETOUCH_METRICS_PORT, value: "9090"}
{{- with .root.Values.token }}
{{- if .secret }}
- name: PRETOUCH_TOKEN
  valueFrom: {secretKeyRef: {name: {{ .secret }}, key: {{ .key }}}}
{{- end }}
{{- end }}
{{- with .root.Values.tracing.endpoint }}
- {name: OTEL_EXPORTER_OTLP_ENDPOINT, value: {{ . | quote }}}
{{- end }}
{{- with .root.Values.env }}
{{ toYaml . }}
{{- end }}
{{- end }}

{{/* gRPC health: a first start may compile kernels, and one that hangs is restarted */}}
{{- define "pretouch.grpcProbes" -}}
startupProbe:
  grpc: {port: {{ . }}}
  periodSeconds: 5
  failureThreshold: 60
readinessProbe:
  grpc: {port: {{ . }}}
  periodSeconds: 5
  timeoutSeconds: 3
livenessProbe:
  grpc: {port: {{ . }}}
  periodSeconds: 15
  timeoutSeconds: 5
  failureThreshold: 4
{{- end }}

{{/* One pod at a time may be away for the sake of the cluster: (dict "root" $ "component" NAME) */}}
{{- define "pretouch.disruptionBudget" -}}
apiVersion: policy/v1
kind: PodDisruptionBudget
metadata:
  name: {{ include "pretouch.name" .root }}-{{ .component }}
  labels: {{ include "pretouch.labels" . | nindent 4 }}
spec:
  maxUnavailable: 1
  selector:
    matchLabels: {{ include "pretouch.selector" . | nindent 6 }}
{{- end }}

{{/* By the queue of CPU jobs, which a Prometheus adapter serves as a metric of the pods: (dict .. "kind" KIND) */}}
{{- define "pretouch.autoscaler" -}}
apiVersion: autoscaling/v2
kind: HorizontalPodAutoscaler
metadata:
  name: {{ include "pretouch.name" .root }}-{{ .component }}
  labels: {{ include "pretouch.labels" . | nindent 4 }}
spec:
  scaleTargetRef:
    apiVersion: apps/v1
    kind: {{ .kind }}
    name: {{ include "pretouch.name" .root }}-{{ .component }}
  minReplicas: {{ .values.autoscaling.minReplicas }}
  maxReplicas: {{ .values.autoscaling.maxReplicas }}
  metrics:
    - type: Pods
      pods:
        metric: {name: pretouch_{{ .component }}_queue_jobs}
        target: {type: AverageValue, averageValue: {{ .values.autoscaling.queueJobs | quote }}}
  behavior:
    scaleDown: {stabilizationWindowSeconds: 300}
{{- end }}
